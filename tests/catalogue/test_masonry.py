"""Masonry: arches at their limit of stability, hyperstatic supports, overhangs, heavy on light, tall columns."""

import numpy as np
import pytest
from conftest import drift, penetration
from scipy.optimize import linprog

import nsdyn as nd

g = 9.81


# -- case 34: the arch -------------------------------------------------------------------------------------------------


def arch_stands(voussoirs, thickness, mu, curved=False):
    """Whether admissible forces carry a semicircular arch of mean radius 1: a linear program in the plane.

    Unknown are the normal force N ≥ 0 and the friction |T| ≤ mu N at both edges of every joint. Voussoirs have flat
    faces like those of the scene, or `curved` ones like those of the literature's limits.
    """
    n, inner, outer = voussoirs, 1 - thickness / 2, 1 + thickness / 2
    joints = np.linspace(np.pi, 0.0, n + 1)
    half = 0.5 * np.pi / n
    chord = np.sin(half) / half if curved else np.cos(half)
    centre = 2 / 3 * chord * (outer**3 - inner**3) / (outer**2 - inner**2)
    forces = np.zeros((n, 3, n + 1, 2, 2))  # voussoir, (x, z, moment), joint, edge, (N, T)
    for j, a in enumerate(joints):
        radial = np.array([np.cos(a), np.sin(a)])
        onwards = np.array([np.sin(a), -np.cos(a)])
        for e, r in enumerate((inner, outer)):
            for c, d in enumerate((onwards, radial)):
                wrench = np.array([*d, r * (radial[0] * d[1] - radial[1] * d[0])])
                if j > 0:
                    forces[j - 1, :, j, e, c] = -wrench
                if j < n:
                    forces[j, :, j, e, c] = wrench
    middle = 0.5 * (joints[1:] + joints[:-1])
    weight = np.stack([np.zeros(n), np.ones(n), centre * np.cos(middle)], axis=1)
    points = 2 * (n + 1)
    cone = np.kron(np.eye(points), [[-mu, 1.0], [-mu, -1.0]])
    answer = linprog(
        np.zeros(2 * points),
        A_ub=cone,
        b_ub=np.zeros(2 * points),
        A_eq=forces.reshape(3 * n, -1),
        b_eq=weight.ravel(),
        bounds=[(0, None), (None, None)] * points,
        method="highs",
    )
    return answer.status == 0


def smallest(stands, low, high):
    """Limit of `stands` between a value that falls and one that stands, to 1e-7."""
    assert stands(high) and not stands(low)
    while high - low > 1e-7:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if stands(middle) else (middle, high)
    return high


@pytest.mark.case(34)
@pytest.mark.parametrize(
    ("voussoirs", "mu", "limit"),
    [
        (5, 0.4, 0.09661),
        (7, 0.4, 0.09624),
        (11, 0.4, 0.10491),
        (21, 0.4, 0.10679),
        (5, 0.35, 0.1196),
        (11, 0.35, 0.1453),
        (21, 0.35, 0.1495),
    ],
)
def test_limits_of_the_literature(voussoirs, mu, limit):
    """Curved voussoirs; half a unit of the last digit. The continuous arch has 0.1075."""
    found = smallest(lambda t: arch_stands(voussoirs, t, mu, curved=True), 0.05, 0.3)
    assert found == pytest.approx(limit, abs=6e-6 if mu == 0.4 else 6e-5)


QUICK = (11, 0.4), (7, 0.35)


@pytest.mark.case(34)
@pytest.mark.parametrize(
    ("voussoirs", "mu"),
    [
        pytest.param(n, mu, marks=[] if (n, mu) == QUICK[1] else pytest.mark.slow)
        for n in (5, 7, 11, 21)
        for mu in (0.4, 0.35)
    ],
)
def test_arch_stands_above_its_limit_and_falls_below(voussoirs, mu):
    """Hinges decide at mu = 0.4, sliding joints at 0.35."""
    limit = smallest(lambda t: arch_stands(voussoirs, t, mu), 0.05, 0.3)
    arch, duration = nd.scenes.load("arch"), 1.0 if (voussoirs, mu) in QUICK else 2.0
    stands = nd.simulate(arch(voussoirs=voussoirs, thickness=1.02 * limit, mu=mu), duration, dt=5e-3)
    assert drift(stands) <= 1e-9
    assert penetration(stands) <= 1e-10
    falls = nd.simulate(arch(voussoirs=voussoirs, thickness=0.98 * limit, mu=mu), 1.4, dt=5e-3)
    assert drift(falls) > 0.5
    assert penetration(falls) <= 1e-10


@pytest.mark.case(34)
@pytest.mark.parametrize("factor", [pytest.param(0.98, marks=pytest.mark.slow), 1.02])
def test_thick_arch_needs_its_friction(factor):
    """At a thickness of 0.15 the springings slide below mu = 0.35 or so."""
    limit = smallest(lambda mu: arch_stands(11, 0.15, mu), 0.2, 0.5)
    assert 0.33 < limit < 0.36
    duration = 0.7 if factor > 1 else 1.4
    scene = nd.scenes.load("arch")(voussoirs=11, thickness=0.15, mu=factor * limit)
    trajectory = nd.simulate(scene, duration, dt=5e-3)
    moved = drift(trajectory)
    assert moved <= 1e-9 if factor > 1 else moved > 0.5


# -- case 35: hyperstatic supports -------------------------------------------------------------------------------------


@pytest.mark.case(35)
def test_forces_on_four_supports():
    """Sum and centre of pressure are exact, the split is not unique: solvers agree in velocity and gap only."""
    splits = []
    for name in ("auto", "newton", "pgs"):
        solver = nd.solvers.by_name(name, 1e-12)
        trajectory = nd.simulate(nd.scenes.load("four_supports")(), 0.2, dt=1e-2, solver=solver)
        contacts = trajectory.contacts(-1)
        force = contacts.impulse[:, 0] / 1e-2
        assert len(force) == 4
        assert force.sum() == pytest.approx(10.0 * g, rel=1e-11)
        pressure = force @ np.asarray(contacts.point)[:, :2] / force.sum()
        np.testing.assert_allclose(pressure, (0.1, -0.05), rtol=0, atol=1e-11)
        assert drift(trajectory) <= 1e-12
        assert np.abs(contacts.gap).max() <= 1e-12
        splits.append(force)
    assert np.abs(splits[1] - splits[2]).max() > 0.1


@pytest.mark.case(35)
def test_box_that_leaves_a_support():
    """With its centre of mass outside three supports' triangle the box tips; just inside it stands."""
    scene = nd.scenes.load("four_supports")
    assert drift(nd.simulate(scene(offset_x=0.4 * (1 - 1e-6), offset_y=0.0), 1.0, dt=1e-2)) <= 1e-9
    # Over the edge by 0.4 mm at first, growing as exp(t sqrt(m g x / J)).
    assert drift(nd.simulate(scene(offset_x=0.4 * (1 + 1e-3), offset_y=0.0), 1.0, dt=1e-2)) > 1e-3


# -- case 36: overhang -------------------------------------------------------------------------------------------------


@pytest.mark.case(36)
@pytest.mark.parametrize("books", [1, 2, 3, pytest.param(5, marks=pytest.mark.slow)])
def test_overhang_of_books(books):
    stands = nd.simulate(nd.scenes.load("overhang")(books=books, excess=-1e-3), 2.0, dt=5e-3)
    assert drift(stands) <= 1e-9
    topples = nd.simulate(nd.scenes.load("overhang")(books=books, excess=1e-3), 2.0, dt=5e-3)
    assert drift(topples) > 0.5


# -- case 37: heavy on light -------------------------------------------------------------------------------------------


def storeys(trajectory, dt):
    """Normal force on the lower face of each storey of a column from the ground up, N."""
    contacts = trajectory.contacts(-1)
    upper = list(dict.fromkeys(contacts.body2))
    owner = np.array([upper.index(name) for name in contacts.body2])
    return np.bincount(owner, weights=contacts.impulse[:, 0]) / dt


def costs(scene, tol):
    """Sweeps of plain Gauss–Seidel to a tolerance, and iterations of Newton, on the problem of the first step."""
    problem = nd.Stepper(scene, dt=1e-2).step().problem
    plain = nd.solvers.PGS(tol=tol, max_iter=1_000_000, memory=0)(problem)
    assert plain.converged
    return plain.iterations, nd.solvers.by_name("newton", 1e-8)(problem).iterations


@pytest.mark.case(37)
@pytest.mark.parametrize("below", [1, 2, 3, 4])
def test_weights_under_a_thousandfold_mass(below):
    trajectory = nd.simulate(nd.scenes.load("heavy_on_light")(ratio=1000.0, below=below), 0.5, dt=1e-2)
    assert drift(trajectory) <= 1e-9
    np.testing.assert_allclose(storeys(trajectory, 1e-2), g * (1000.0 + np.arange(below, -1, -1)), rtol=1e-9)


@pytest.mark.case(37)
def test_mass_ratio_costs_gauss_seidel_not_newton():
    load = nd.scenes.load("heavy_on_light")
    sweeps, newton = zip(*(costs(load(ratio=ratio), 1e-8) for ratio in (1.0, 10.0, 100.0)), strict=True)
    # Sweeps are counted in fives; in proportion to the ratio.
    assert 5 <= sweeps[1] / sweeps[0] <= 15 and 5 <= sweeps[2] / sweeps[1] <= 15
    assert max(newton) <= 20


# -- case 38: tall columns ---------------------------------------------------------------------------------------------


@pytest.mark.case(38)
@pytest.mark.parametrize(("height", "duration"), [(10, 5.0), (50, 0.5), (100, 0.5)])
def test_weights_in_a_tall_column(height, duration):
    trajectory = nd.simulate(nd.scenes.load("stack")(height=height), duration, dt=1e-2)
    assert drift(trajectory) <= 1e-9
    np.testing.assert_allclose(storeys(trajectory, 1e-2), g * np.arange(height, 0, -1), rtol=1e-9)


@pytest.mark.case(38)
def test_height_costs_gauss_seidel_its_square():
    load = nd.scenes.load("stack")
    sweeps, newton = zip(*(costs(load(height=height), 1e-6) for height in (2, 4, 8)), strict=True)
    assert sweeps[1] >= 4 * sweeps[0] and sweeps[2] >= 4 * sweeps[1]
    assert max(newton) <= 30
