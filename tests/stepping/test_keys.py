"""Keys of contacts: each names one contact, for as long as it lasts."""

import anything
import numpy as np
import pytest

import nsdyn as nd


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("seed", [pytest.param(550081, marks=pytest.mark.slow), 580025])
def test_no_key_names_two_contacts(seed, tmp_path):
    """In violent collisions: islands are made again, and moves meet what their ends have shown."""
    scene, options, _ = anything.random_scene(seed, tmp_path)
    stepper, most = nd.Stepper(scene, **{k: options[k] for k in ("dt", "impact", "theta")}), 0
    for _ in range(20):
        step, pairs = stepper.step(), {}
        end = stepper.get_state().instant.contacts
        assert np.unique(end.key).size == end.key.size
        for contacts in (step.contacts, end):
            for key, *pair in zip(contacts.key, contacts.geom1, contacts.geom2, strict=True):
                assert pairs.setdefault(key, pair) == pair
        most = max(most, len(pairs))
    assert most > 20


@pytest.mark.parametrize("dt", [4e-3, 2e-3])
def test_what_rocks_onto_a_face_carries_on_where_it_carried(dt):
    """The contact on its edge and a point of the face beside it become one when the face turns flush.

    It had the key of the point beside, was left out, and no impact at the other end of the face could be located.
    """
    vertices, material = np.random.default_rng(3).normal(size=(60, 3)), nd.Material(0.5)
    vertices *= 0.1 / np.linalg.norm(vertices, axis=1)[:, None]
    scene, roll, tilt = nd.Scene(), np.pi / 4 - 0.005, np.array([0.3, 1.0, 0.2]) / np.sqrt(1.13)
    lies = {"quaternion": (np.sin(roll), 0, 0, np.cos(roll)), "position": (0, 0, 0.2)}
    scene.add_cylinder("log", 0.09, 0.3, fixed=True, material=material, **lies)
    turned = (*np.sin(0.035) * tilt, np.cos(0.035))
    moves = {"position": (0.003, 0.002, 0.6), "quaternion": turned, "angular_velocity": (0.5, 1, 2)}
    scene.add_convex("gem", vertices, 1.0, material=material, **moves)
    run = nd.simulate(scene, 0.32, dt)
    for k in range(1, run.t.size):
        moved = run.contacts(k).duration > 0.0
        assert run.contacts(k).work_normal[moved].min(initial=0.0) > -1e-4  # J; impacts take 1e-2 J, in no time
    # m: where steps of 0.2 ms lead, to the second order of 4 ms; it was 4e-4 m off.
    np.testing.assert_allclose(run.body("gem").position[-1], (-0.006456, 0.041090, 0.385891), rtol=0, atol=1e-5)
