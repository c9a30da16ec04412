"""What a page knows of a recording: impacts, contacts, curves, and how they are packed."""

import json

import numpy as np
import pytest
from recordings import recording
from test_viewer import contents, unpacked

import nsdyn as nd
from nsdyn.dynamics.ledger import LAYERS, NUMERICS, PHYSICS
from nsdyn.recording.columns import ENERGIES
from nsdyn.view import contact_points, curves, keyframes, marks, payload, titles, viewer
from nsdyn.view import contents as packing
from nsdyn.view.contents import packed


@pytest.fixture(scope="module")
def bouncing():
    return nd.simulate(nd.scenes.load("bounce")(), 1.3, dt=1e-3)


@pytest.fixture(scope="module")
def sliding():
    return nd.simulate(nd.scenes.load("slide")(), 0.2, dt=1e-2)


def test_packed_values_come_back():
    arrays = {
        "small": np.array([3, 1, 2], np.uint8),
        "whole": np.arange(5, dtype=np.uint32) << 20,
        "real": np.array([[1.5, -np.inf], [np.nan, 1e-300]]),
        "none": np.empty((0, 3), np.float32),
    }
    values, back = unpacked(payload.pack({"name": "</script> é"}, arrays))
    assert values == {"name": "</script> é"}
    for name, array in arrays.items():
        assert back[name].dtype == array.dtype
        np.testing.assert_array_equal(back[name], array.ravel())


def test_steps_that_miss_the_tolerance_are_told(sliding):
    """In the heading of the page: a recording of which a part is solved loosely does not say that it is not."""
    assert titles.words(sliding) == "steps of 10 ms, contacts solved to 1e-8 m/s by auto"
    status = np.array([nd.Status.LOOSE] * 13 + [nd.Status.STALLED] * 2 + [nd.Status.JAM] * 5)
    partly = nd.Trajectory(sliding.meta, sliding.scene, sliding.columns | {"solver/status": status})
    assert titles.words(partly).endswith(" by auto, 13 of 20 steps to 1e-4, 2 of 20 steps missed it")
    shown = unpacked(packed(partly, None, False, 2000, None))[0]["words"]
    assert shown == titles.words(partly)


def test_rounding_keeps_fifteen_bits(rng):
    values = rng.normal(size=1000) * 10.0 ** rng.integers(-20, 20, 1000)
    kept = payload.rounded(values)
    np.testing.assert_allclose(kept, values, rtol=2.0**-16)
    assert not (kept.view(np.uint32) & 0xFF).any()
    np.testing.assert_array_equal(payload.rounded([np.inf, -np.inf, 0.0, np.nan]), [np.inf, -np.inf, 0.0, np.nan])


def test_keyframes_are_even_and_have_what_is_wanted():
    t = np.linspace(0.0, 1.0, 101)
    assert keyframes.choose(t, 10, 3000, []).tolist() == list(range(0, 101, 10))
    assert keyframes.choose(t, 10, 3000, [7, 20]).tolist() == sorted([7, *range(0, 101, 10)])
    assert keyframes.choose(t, 10, 12, [33, 7, 5]).tolist() == sorted([33, *range(0, 101, 10)])  # first first
    assert keyframes.choose(t[:1], 10, 3000, []).tolist() == [0]
    assert keyframes.thinned(10, 20).tolist() == list(range(10))
    assert keyframes.thinned(1001, 11).tolist() == list(range(0, 1001, 100))


def test_bounces_are_impacts(bouncing):
    """A ball of 1 kg falls 1 m; it meets the ground at 4.43 m/s and 0.8 of it later."""
    found = marks.find(bouncing)
    speed = np.sqrt(2 * 9.81)
    assert bouncing.t[found.step] == pytest.approx([speed / 9.81, 2.6 * speed / 9.81], abs=1e-3)
    # What gravity gives in a step is not counted.
    np.testing.assert_allclose(found.speed, [speed, 0.8 * speed], rtol=0, atol=9.81e-3)
    np.testing.assert_allclose(found.impulse, [1.8 * speed, 1.8 * 0.8 * speed], rtol=0, atol=2 * 9.81e-3)


def test_what_slides_or_rests_has_no_impacts(sliding):
    assert marks.find(sliding).step.size == 0
    stack = nd.simulate(nd.scenes.load("stack")(height=3), 0.1, dt=1e-2)
    assert marks.find(stack).step.size == 0


def rolling(speed, height=0.0, restitution=0.0, dt=1e-3, duration=0.06):
    """A ball of 0.1 m that rolls, once it is on the ground."""
    scene, material = nd.Scene(), nd.Material(mu=0.5, restitution=restitution)
    scene.add_halfspace("ground", material=material)
    scene.add_sphere(
        "ball",
        0.1,
        1.0,
        position=(0, 0, 0.1 + height),
        material=material,
        linear_velocity=(speed, 0, 0),
        angular_velocity=(0, 10 * speed, 0),
    )
    return nd.simulate(scene, duration, dt=dt)


@pytest.mark.parametrize("restitution", [0.0, 0.5])
@pytest.mark.parametrize("speed", [1.0, 5.0, 100.0])
def test_what_rolls_has_no_impacts(speed, restitution):
    """However fast: v² is up to 10000 times r g."""
    assert marks.find(rolling(speed, restitution=restitution)).step.size == 0


@pytest.mark.parametrize("speed", [0.0, 100.0])
def test_a_ball_that_rolls_has_landed_once(speed):
    """It falls 1 cm, and the impact is that of its fall, not of its roll; a slower landing is one too."""
    trajectory = rolling(speed, height=0.01, duration=0.1)
    found = marks.find(trajectory)
    fallen = np.sqrt(2 * 9.81 * 0.01)
    assert trajectory.t[found.step] == pytest.approx([fallen / 9.81], abs=1.1e-3)
    assert 0.8 * fallen < found.speed[0] < fallen * (1 + 1e-9)  # it may be stopped in two parts
    slow = marks.find(rolling(speed, height=1e-4))  # 0.044 m/s
    assert slow.step.size == 1 and 0.03 < slow.speed[0] < 0.0443


@pytest.mark.parametrize(
    ("name", "duration", "dt"), [("roll", 1.0, 1e-2), ("roll_down", 1.0, 1e-2), ("euler_disk", 0.1, 1e-3)]
)
def test_scenes_that_roll_have_no_impacts(name, duration, dt):
    assert marks.find(nd.simulate(nd.scenes.load(name)(), duration, dt=dt)).step.size == 0


def test_a_new_scene_has_no_impacts(tmp_path):
    """A ball that rolls down, a crate that slides."""
    (tmp_path / "mine.py").write_text(nd.scenes.template())
    scene = nd.scenes.load(str(tmp_path / "mine.py"))()
    assert marks.find(nd.simulate(scene, 1.0, dt=5e-3)).step.size == 0


@pytest.mark.parametrize("gravity", [9.81, 0.0])
def test_what_is_held_has_no_impacts(gravity):
    """An ellipsoid that rolls at 30 rad/s under 200 times its weight: its gap opens and closes by what steps err."""
    scene, material = nd.Scene(gravity=(0, 0, -gravity)), nd.Material(mu=0.8)
    scene.add_halfspace("ground", material=material)
    scene.add_ellipsoid(
        "ellipsoid",
        (0.1, 0.09, 0.08),
        1.0,
        position=(0, 0, 0.08),
        material=material,
        linear_velocity=(0, -2.4, 0),
        angular_velocity=(30, 0, 3),
    )
    trajectory = nd.simulate(scene, 0.2, dt=1e-3, external_force=lambda t, q, v: {"ellipsoid": (0, 0, -2000.0)})
    assert marks.find(trajectory).step.size == 0


def test_corners_share_the_impulse_of_a_landing():
    """A box of 1 kg that falls flat and bounces: a quarter of (1 + e) m sqrt(2 g 0.05 m) each."""
    scene, material = nd.Scene(), nd.Material(restitution=0.5)
    scene.add_halfspace("ground", material=material)
    scene.add_box("box", (0.2, 0.2, 0.2), 1.0, position=(0, 0, 0.15), material=material)
    found = marks.find(nd.simulate(scene, 0.12, dt=1e-3))
    # It is located to a billionth of the size of the box.
    assert found.speed == pytest.approx([np.sqrt(2 * 9.81 * 0.05)], rel=1e-6)
    assert found.impulse == pytest.approx(1.5 / 4 * found.speed, rel=1e-6)


@pytest.mark.parametrize(("mass", "carried"), [(0.01, 1.0), (10.0, 0.01)])
def test_what_lands_on_what_rests_is_an_impact(mass, carried):
    """A ball on a box, which only rests on the ground: sqrt(2 g 0.05 m), in one step or two."""
    scene = nd.Scene()
    scene.add_halfspace("ground")
    scene.add_box("box", (0.2, 0.2, 0.2), carried, position=(0, 0, 0.1))
    scene.add_sphere("ball", 0.05, mass, position=(0, 0, 0.3))
    found = marks.find(nd.simulate(scene, 0.15, dt=1e-3))
    assert found.speed[0] == pytest.approx(np.sqrt(2 * 9.81 * 0.05), abs=9.81e-3)
    assert (found.geoms == (1, 2)).all() and found.step[-1] - found.step[0] < 2


@pytest.mark.parametrize(
    ("name", "duration", "dt", "count"), [("rocking", 1.0, 1e-3, 2), ("domino", 0.3, 2e-3, 4), ("cradle", 0.3, 1e-3, 4)]
)
def test_impacts_are_where_the_ledger_has_them(name, duration, dt, count):
    """All but a hundredth of what impacts took was taken in steps with a mark, or in the step after it."""
    trajectory = nd.simulate(nd.scenes.load(name)(), duration, dt=dt)
    found = marks.find(trajectory)
    assert found.step.size == count
    taken = np.abs(trajectory.energy.normal)
    marked = np.unique(np.concatenate([found.step, found.step + 1]).clip(max=trajectory.steps)) - 1
    assert taken.sum() - taken[marked].sum() <= 0.01 * taken.sum()


def test_impacts_of_links_are_found():
    """The sleeve of the woodpecker strikes its pole at 0.3 m/s, then more softly, twice a period."""
    trajectory = nd.simulate(nd.scenes.load("woodpecker")(), 0.3, dt=1e-3)
    found = marks.find(trajectory)
    assert found.step.size > 4 and (found.speed > 9.81e-3).all()
    assert np.sort(found.speed)[-2:] == pytest.approx(0.298, abs=5e-3)


def test_sparse_recordings_have_no_impacts(bouncing):
    every = nd.simulate(nd.scenes.load("bounce")(), 0.6, dt=1e-3, every=5)
    assert marks.find(every).step.size == 0


def test_contacts_of_states_are_those_of_the_steps_before(sliding):
    rows = np.array([0, 3, 7])
    found = contact_points.at(sliding, rows)
    assert found["offset"].tolist() == [0, 0, 4, 8]
    for k, row in enumerate(rows[1:], 1):
        part = slice(*found["offset"][k : k + 2])
        contacts = sliding.contacts(int(row))
        order = np.lexsort(contacts.point.T)
        ours = np.lexsort(found["point"][part].T)
        np.testing.assert_array_equal(found["point"][part][ours], contacts.point[order])
        np.testing.assert_array_equal(found["gap"][part][ours], contacts.gap[order])
        np.testing.assert_array_equal(found["state"][part][ours], contacts.status[order] + contact_points.EDGE)
        # The impulse in axes that follow from the normal is the one in the world.
        t1, t2 = contact_points.axes(found["normal"][part])
        r = found["r"][part]
        world = r[:, :1] * found["normal"][part] + r[:, 1:2] * t1 + r[:, 2:] * t2
        np.testing.assert_allclose(world[ours], contacts.impulse_world[order], rtol=0, atol=1e-12)
    # What the four points dissipated until then is the work of friction of the whole slide.
    part = slice(*found["offset"][2:4])
    assert found["taken"][part].sum() == pytest.approx(-sliding.energy.friction[:7].sum(), rel=1e-9)


def test_axes_make_right_handed_frames(rng):
    n = rng.normal(size=(50, 3))
    n = np.vstack([n / np.linalg.norm(n, axis=1, keepdims=True), np.eye(3), -np.eye(3)])
    frames = np.stack([n, *contact_points.axes(n)], axis=1)
    np.testing.assert_allclose(frames @ frames.transpose(0, 2, 1), np.tile(np.eye(3), (56, 1, 1)), atol=1e-14)
    np.testing.assert_allclose(np.linalg.det(frames), 1.0, rtol=1e-14)


def test_curves_are_the_ledger(bouncing, monkeypatch):
    monkeypatch.setattr(curves, "MAX_POINTS", 14)
    found = curves.ledger(bouncing)
    assert found["t"].tolist() == bouncing.t[::100].tolist()
    took = LAYERS.keys() - set(ENERGIES)
    assert took - {"drives"} | {"external", "constraint"} == set(PHYSICS)
    sums = sum(found[name] for name in ("put_in", *took, *NUMERICS))
    # Of 9.81 J.
    np.testing.assert_allclose(found["kinetic"] + found["potential"] - sums, found["potential"][0], rtol=1e-12)
    assert found["potential"].min() >= 0.0
    worst = [bouncing.gauss.bound[k : k + 100].max() for k in range(0, 1300, 100)]
    assert found["bound"][1:].tolist() == worst and np.isnan(found["bound"][0])


def test_a_page_is_told_what_its_ledger_shows(sliding):
    """The stack from below, in words and colours; every layer has its curve."""
    values, arrays = unpacked(packed(sliding, None, False, 2000, None))
    shown = {layer["name"]: (layer["label"], layer["colour"], layer["sign"]) for layer in values["layers"]}
    assert list(shown) == list(LAYERS)
    assert shown["potential"] == ("potential", "#b9cfe4", 1) and shown["normal"] == ("impacts took", "#b5405e", -1)
    assert {f"ledger/{name}" for name in (*shown, *values["numerics"], "put_in")} <= arrays.keys()


def test_bodies_have_speed_and_energy(bouncing):
    found = curves.bodies(bouncing, np.array([0, 400]))
    speed = np.linalg.norm(bouncing.body("ball").linear_velocity[[0, 400]], axis=1)
    np.testing.assert_allclose(found["speed"][:, 0], speed, rtol=1e-12)
    np.testing.assert_allclose(found["kinetic"].sum(axis=1), bouncing.energy.kinetic[[0, 400]], rtol=1e-12)


def test_what_is_left_out_is_told(sliding, monkeypatch):
    monkeypatch.setattr(packing, "MAX_CONTACTS", 30)
    monkeypatch.setattr(curves, "MAX_POINTS", 10)
    values, arrays = unpacked(packed(sliding, 100, False, 3000, None))
    assert values["notes"] == ["all 21 recorded states", "contacts of one in 3 of them"]
    assert arrays["contacts/t"].tolist() == sliding.t[::3].tolist()
    assert arrays["contacts/id"].size == 24
    assert unpacked(packed(sliding, 10, False, 3000, None))[0]["notes"][:2] == [
        "3 of 21 recorded states",
        "curves of 10 of them, figures of checks the largest in between",
    ]


def test_all_states_are_kept_where_they_are_cheap(bouncing, monkeypatch):
    usual, whole = packed(bouncing, 30, False, 3000, None), packed(bouncing, None, False, 3000, None)
    assert len(usual) < len(whole) < len(usual) + packing.CHEAP
    arrays = unpacked(whole)[1]
    assert arrays["t"].tolist() == arrays["ledger/t"].tolist() == bouncing.t.tolist()
    monkeypatch.setattr(packing, "CHEAP", len(whole) - len(usual))
    assert packed(bouncing, None, False, 3000, None) == usual
    monkeypatch.undo()
    monkeypatch.setattr(packing, "UNPACKED", 28 * bouncing.t.size)
    assert packed(bouncing, None, False, 3000, None) == usual


def test_the_scene_is_built_once(bouncing, monkeypatch):
    """Also where two selections of states are tried."""
    built, packs = [], []
    shapes, pack = packing.shape_commands, payload.pack
    monkeypatch.setattr(packing, "shape_commands", lambda *given: built.append(1) or shapes(*given))
    monkeypatch.setattr(payload, "pack", lambda *given: packs.append(1) or pack(*given))
    packed(bouncing, None, False, 3000, None)
    assert (len(built), len(packs)) == (1, 2)


def test_forces_push_the_moving_body(sliding):
    """They carry and brake the box: the mean since the state before."""
    values, arrays = unpacked(packed(sliding, 10, "pair", 3000, None))
    force = arrays["forces/force"].reshape(-1, 3)
    assert values["forces"] is True and arrays["forces/offset"].tolist() == [0, 0, 1, 2]
    mean = [sliding.force("box")[k : k + 10].mean(axis=0) for k in (0, 10)]
    np.testing.assert_allclose(force, mean, rtol=0, atol=1e-3)  # 15 bits of 10 N
    assert values["units"]["forces"] == pytest.approx(np.linalg.norm(mean[0]), rel=1e-3)


def test_values_are_json_of_finite_numbers(bouncing):
    values, _ = contents(viewer.html(bouncing))
    assert json.loads(json.dumps(values, allow_nan=False)) == values


@pytest.mark.slow
def test_large_pages_stay_small(rng):
    """3000 frames of 100 bodies that all move, and 300 contacts in each, at random: the worst for a page."""
    scene = nd.Scene(name="many")
    scene.add_halfspace("ground")
    for k in range(100):
        scene.add_box(f"box{k}", (0.2, 0.2, 0.2), 1.0, position=(k % 10, k // 10, 0.1))
    n, m = 3000, 300 * 2999
    place = 2.0 * np.sin(np.arange(n)[:, None, None] / 30 * rng.uniform(0.5, 3.0, (100, 3)))
    turn = np.cumsum(rng.normal(0.0, 0.05, (n, 100, 4)), axis=0) + rng.normal(0.0, 0.01, (n, 100, 4))
    q = np.concatenate([place, turn / np.linalg.norm(turn, axis=-1, keepdims=True)], axis=-1)
    normal = rng.normal(size=(m, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    first = rng.integers(0, 100, m)
    contacts = {
        "offset": 300 * np.arange(n),
        "geom1": first.astype(np.int32),
        "geom2": first.astype(np.int32) + 1,
        "key": rng.integers(0, 8, m),
        "point": rng.uniform(-2, 2, (m, 3)),
        "normal": normal,
        "tangent": contact_points.axes(normal)[0],
        "couple": np.zeros((m, 3)),
        "gap": rng.normal(0, 1e-9, m),
        "mu": np.full(m, 0.5),
        "restitution": np.zeros(m),
        "u": rng.normal(size=(m, 3)),
        "impulse": np.abs(rng.normal(size=(m, 1))) * np.insert(rng.uniform(-0.35, 0.35, (m, 2)), 0, 1.0, axis=1),
        "status": rng.integers(0, 3, m).astype(np.int8),
        "work_normal": -rng.uniform(size=m),
        "work_friction": -rng.uniform(size=m),
        "time": np.full(m, 0.5 / 30),
        "duration": np.full(m, 1 / 30),
    }
    trajectory = recording(scene, q.reshape(n, -1), dt=1 / 30, contacts=contacts, v=rng.normal(size=(n, 600)))
    page = viewer.html(trajectory)
    assert len(page) < 25e6
    assert contents(page)[1]["t"].size == n
