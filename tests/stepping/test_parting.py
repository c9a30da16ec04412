"""What parts and is pressed all the same: no normal impulse of a move does positive work there."""

import numpy as np
import pytest

import nsdyn as nd
from nsdyn._kernels.stepping import law


@pytest.mark.parametrize("free", [(-0.7, 0.2, 0.0), (-2.0, -0.4, 0.3)], ids=["held back", "thrown back"])
def test_what_parts_comes_back_without_work(free: tuple[float, float, float]) -> None:
    """One contact of W = 1: u⁻ = 0.5 m/s apart, and forces that press it within the move; r ≥ 0 makes u⁺ + u⁻ = 0.

    The gap of the end, 1 mm in 5 ms, asks for u⁺ = -0.2 m/s: the mean velocity would be along the impulse.
    """
    u, none = np.array([0.5, 0.1, 0.0]), np.empty(0)
    local = np.array([u, u, free, np.zeros(3), np.zeros(3)])
    gap_rule, b = (1e-10, 0.0, 5e-3, 1e-2), np.empty(3)
    laws = np.array([1e-3]), np.zeros(1), none, np.zeros(1), gap_rule
    law.offsets(local, laws, np.zeros(1, np.bool_), np.zeros(1, np.bool_), b)
    r = -np.minimum(b, 0.0) if b[0] >= 0.0 else -b  # enough friction to stick
    after = np.array(free) + r
    assert r[0] > 0.0
    assert 0.5 * (u[0] + after[0]) * r[0] <= 1e-15


@pytest.mark.parametrize("beside", [False, True], ids=["alone", "beside a box"])
@pytest.mark.parametrize(("spin", "mu"), [(30.0, 0.0), (100.0, 0.0), (100.0, 0.5), (150.0, 0.5)])
def test_coarse_steps_of_a_thrown_ellipsoid_create_no_energy(spin: float, mu: float, beside: bool) -> None:
    """It turns by up to 1.5 rad a step and falls by as much as it is thick."""
    scene, material = nd.Scene(), nd.Material(mu=mu)
    scene.add_halfspace("ground", material=material)
    if beside:
        scene.add_box("box", (0.01, 0.01, 0.01), 1e-3, position=(1.0, 0.0, 0.005))
    thrown = {"position": (0, 0, 0.011), "angular_velocity": (0, spin, 0), "material": material}
    scene.add_ellipsoid("body", (0.01, 0.005, 0.002), 1.0, **thrown)
    stepper, energy = nd.Stepper(scene, dt=1e-2), []
    for _ in range(40):
        ledger = stepper.step().ledger
        energy.append(ledger.kinetic + ledger.potential)
    gain = float((energy - np.minimum.accumulate(energy)).max())
    assert gain <= 1e-5 * np.ptp(energy)
