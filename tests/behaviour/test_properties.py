"""Laws that every step of every scene obeys, tried on random scenes."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import nsdyn as nd

LENGTH = st.floats(0.05, 0.3)


@st.composite
def scenes(draw):
    """Up to five bodies of random shapes thrown at each other over the ground."""
    scene = nd.Scene(gravity=(0, 0, draw(st.sampled_from([0.0, -9.81]))))
    material = nd.Material(draw(st.floats(0.0, 2.0)))
    scene.add_halfspace("ground", material=material)
    for k in range(draw(st.integers(1, 5))):
        quaternion = np.array([draw(st.floats(-1, 1)) for _ in range(3)] + [1.5])
        common = {
            "mass": draw(st.floats(0.1, 100.0)),
            # At least 0.66 m apart: no shape below is longer from its centre than 0.33 m.
            "position": (0.66 * (k % 2), 0.66 * (k // 2 % 2), 0.4 + 0.66 * (k // 4)),
            "quaternion": quaternion / np.linalg.norm(quaternion),
            "linear_velocity": [draw(st.floats(-3, 3)) for _ in range(3)],
            "angular_velocity": [draw(st.floats(-5, 5)) for _ in range(3)],
            "material": material,
        }
        kind = draw(st.sampled_from(["box", "sphere", "capsule", "cylinder"]))
        if kind == "box":
            scene.add_box(f"b{k}", [draw(LENGTH) for _ in range(3)], **common)
        elif kind == "sphere":
            scene.add_sphere(f"b{k}", draw(LENGTH), **common)
        elif kind == "capsule":
            scene.add_capsule(f"b{k}", draw(LENGTH) / 2, draw(LENGTH), **common)
        else:
            scene.add_cylinder(f"b{k}", draw(LENGTH) / 2, draw(LENGTH), **common)
    return scene


@pytest.mark.parametrize("examples", [10, pytest.param(40, marks=pytest.mark.slow)])
def test_every_step(examples):
    more = settings(
        max_examples=examples, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow]
    )
    more(given(scenes())(every_step))()


def every_step(scene):
    stepper = nd.Stepper(scene, dt=5e-3, on_fail="ignore")
    kinetic = stepper.start().energy["kinetic"]
    for _ in range(60):
        before = stepper.get_state()
        step = stepper.step()
        energy, r, mu = step.energy, step.r, step.contacts.mu
        scale = max(kinetic, energy["kinetic"], abs(energy["potential"]), 1.0)
        # The ledger closes whatever the solver did.
        assert abs(energy["defect"]) <= 1e-12 * scale
        # Impulses are in their cones and friction never adds energy.
        assert (r[:, 0] >= 0).all()
        assert (np.hypot(r[:, 1], r[:, 2]) <= mu * r[:, 0] * (1 + 1e-12) + 1e-300).all()
        # Momentum: what the contacts with the ground gave and what gravity gave.
        mass = stepper.dynamics.mass
        change = (mass[:, None] * (stepper.get_state().instant.v - before.instant.v).reshape(-1, 6)[:, :3]).sum(axis=0)
        ground = step.contacts.frame1 < 0
        given_ = np.einsum("ci,cij->j", r[ground], step.frame[ground]) + mass.sum() * 5e-3 * scene.gravity
        np.testing.assert_allclose(change, given_, rtol=0, atol=1e-11 * max(1.0, mass.sum()))
        if step.solution.converged:
            slack = 1e-7 * max(1.0, float(np.abs(r).sum(initial=0.0)))
            # Signorini: closed or speculative contacts do not close further, and an impulse holds only a contact. The
            # problem is that of the last move, y its velocity with what the motion adds.
            y, p = step.solution.u.reshape(-1, 3), step.solution.r.reshape(-1, 3)
            assert (y[:, 0] >= -1e-7).all()
            assert (np.abs(p[:, 0] * y[:, 0]) <= slack).all()
            # Friction opposes slip.
            assert (y * p).sum() <= slack
            assert step.gauss.gap <= slack
        kinetic = energy["kinetic"]
