"""Every formulation vanishes on solved problems and nowhere near them; derivatives against differences."""

from pathlib import Path

import numpy as np
import pytest
from test_solvers import CASES

import nsdyn as nd
from nsdyn.literature import formulations as fm
from nsdyn.problem import cones

FILES = Path(__file__).resolve().parents[3] / "shared" / "fc3d"
RESIDUALS = [
    fm.residual_natural_map,
    fm.residual_jean_moreau,
    fm.residual_alart_curnier,
    fm.residual_fischer_burmeister,
    fm.residual_hueber_stadler_wohlmuth,
    fm.residual_xuewen_soh_wanji,
    fm.residual_soccp,
    fm.residual_quasi_variational_inequality,
    fm.residual_bipotential,
]
NAMES = sorted(fm.ELEMENTS)


@pytest.fixture(scope="module")
def solved():
    return {name: nd.solve(problem, tol=1e-12).r for name, problem in CASES.items()}


@pytest.mark.parametrize("residual", RESIDUALS, ids=lambda f: f.__name__)
@pytest.mark.parametrize("name", CASES)
def test_zero_on_solved_problems(solved, residual, name):
    # Impulses and velocities of order 1, solved to 1e-12 or round-off. Fischer–Burmeister at a contact where both
    # parts touch the boundary squares small numbers and takes the root: 1e-8 is the root of round-off.
    np.testing.assert_allclose(residual(CASES[name], solved[name]), 0.0, rtol=0, atol=3e-8)


@pytest.mark.parametrize("residual", RESIDUALS, ids=lambda f: f.__name__)
def test_not_zero_elsewhere(solved, residual, rng):
    for name, problem in CASES.items():
        away = solved[name] + rng.normal(size=problem.q.size)
        assert np.abs(residual(problem, away)).max() > 1e-3


@pytest.mark.parametrize("name", CASES)
def test_all_residuals_vanish_together(solved, name):
    """On the way to a solution every residual falls with the distance, a hundredth at a hundredth of it or faster."""
    problem, r = CASES[name], solved[name]
    d = np.cos(1.0 + np.arange(r.size))
    for residual in RESIDUALS:
        far, near = (np.linalg.norm(residual(problem, r + h * d)) for h in (1e-3, 1e-5))
        # 1 % and 5 % of it: piecewise smooth functions keep their slope only nearly. 3e-8 as above.
        assert 0.0 < near <= 0.0105 * far + 3e-8, residual.__name__


def test_gap_of_the_quasi_variational_inequality_is_a_maximum(rng):
    """u·(r - s) - ‖r - s‖²/2ρ sampled over half-line times disk never exceeds it and comes close."""
    problem = CASES["definite0"]
    r, rho = rng.normal(size=12) + np.tile([2.0, 0.0, 0.0], 4), np.array([[0.3, 0.5]] * 4)
    gap, u = fm.quasi_variational_gap(problem, r, rho), problem.velocity(r).reshape(-1, 3)
    n, radius, angle = np.meshgrid(np.linspace(0, 8, 81), np.linspace(0, 1, 41), np.linspace(0, 2 * np.pi, 321))
    for c, x in enumerate(r.reshape(-1, 3)):
        size = problem.mu[c] * max(x[0], 0.0) * radius
        s = np.stack((n, size * np.cos(angle), size * np.sin(angle)))
        away = x[:, None, None, None] - s
        weight = np.array([0.3, 0.5, 0.5])[:, None, None, None]
        sampled = (np.einsum("i,i...->...", u[c], away) - (away**2 / weight).sum(axis=0) / 2).max()
        # The grid misses the maximum of a function of curvature 1/ρ by at most (spacing / 2)² / 2ρ = 4e-3 a direction.
        assert gap[c] - 1.2e-2 <= sampled <= gap[c] + 1e-12


def test_gap_of_the_quasi_variational_inequality_and_its_natural_map(rng):
    """For r ∈ C(r_N) the gap is at least ‖r - P_C(r - ρ u)‖²/2ρ: both vanish together."""
    problem = CASES["definite1"]
    r = cones.project(rng.normal(size=(4, 3)) + np.eye(3)[0], problem.mu).ravel()
    natural = fm.residual_jean_moreau(problem, r).reshape(-1, 3)
    bound = 0.5 * problem.scales * (natural**2).sum(axis=1)
    assert (fm.quasi_variational_gap(problem, r) >= bound - 1e-14).all() and bound.max() > 1e-3


def test_bipotential_is_above_its_duality_product(rng):
    """b(-u, r) ≥ -u·r for every admissible pair; equality is Coulomb's law, `FC3D.gap` their sum."""
    mu = rng.uniform(0.1, 1.0, 50)
    r, u = cones.project(rng.normal(size=(50, 3)), mu), rng.normal(size=(50, 3))
    u[:, 0] = np.abs(u[:, 0])
    problem = nd.FC3D(np.eye(150), u.ravel() - r.ravel(), mu)
    value = fm.residual_bipotential(problem, r.ravel())
    assert value[:50].min() >= -1e-15 and not value[50:].any(where=np.abs(value[50:]) > 1e-15)
    np.testing.assert_allclose(value[:50].sum(), problem.gap(r.ravel()), rtol=1e-13)


@pytest.mark.parametrize("name", CASES)
def test_normal_map(solved, name):
    problem, r = CASES[name], solved[name]
    u = problem.velocity(r).reshape(-1, 3)
    z = r - (cones.saxce(u, problem.mu) / problem.scales[:, None]).ravel()
    # z is off by the round-off of r and u alone.
    np.testing.assert_allclose(fm.residual_normal_map(problem, z), 0.0, rtol=0, atol=1e-10)
    np.testing.assert_allclose(cones.project(z.reshape(-1, 3), problem.mu).ravel(), r, rtol=0, atol=1e-10)


@pytest.mark.skipif(not FILES.is_dir(), reason="the folder of FCLIB problems is not here")
@pytest.mark.parametrize("name", sorted(path.name for path in FILES.glob("*.hdf5")))
def test_zero_on_problems_of_the_literature(name):
    problem = nd.fclib.read(FILES / name)
    r = nd.solve(problem, "tresca", tol=1e-8).r  # the one reference solver that reaches this on all of them
    start = r + 1e-2 * np.abs(r).max(initial=1.0) * np.cos(np.arange(r.size))
    for residual in RESIDUALS:
        # Solved to 1e-8 of q: five digits below a point 1 % away, whatever the units of the formulation.
        ratio = np.linalg.norm(residual(problem, r)) / np.linalg.norm(residual(problem, start))
        assert ratio <= 1e-5, residual.__name__


def test_the_printed_xuewen_soh_wanji_admits_friction_along_the_slip():
    """Sliding along T2 with friction along T2 too: the printed third line is 0, the corrected one is not."""
    mu, r = 0.5, np.array([1.0, 0.0, 0.5])
    problem = nd.FC3D(np.eye(3), np.array([0.0, 0.0, 1.0]) - r, np.array([mu]))
    u = problem.velocity(r)
    printed = [min(u[0], r[0]), min(abs(u[2]), mu * r[0] - abs(r[2])), abs(u[1] * r[2] - u[2] * r[1]) + u[1] * r[1]]
    assert printed == [0.0, 0.0, 0.0] and problem.residual(r) > 0.1
    np.testing.assert_allclose(fm.residual_xuewen_soh_wanji(problem, r), [0.0, 0.0, 0.5])


@pytest.mark.parametrize("name", NAMES)
def test_jacobian_against_differences(name, rng):
    residual = {
        "natural": fm.residual_natural_map,
        "jean-moreau": fm.residual_jean_moreau,
        "alart-curnier": fm.residual_alart_curnier,
        "fischer-burmeister": fm.residual_fischer_burmeister,
    }[name]
    states = np.zeros(3, bool)
    for k in range(40):
        A = rng.normal(size=(9, 9))
        # μ = 0 in one contact of the first ten; W unsymmetric in every second problem.
        mu = rng.uniform(0.1, 1.5, 3) * (np.arange(3) > 0 if k < 10 else 1.0)
        W = A @ A.T + (A - A.T if k % 2 else 0.0)
        problem, r = nd.FC3D(W, rng.normal(size=9), mu), rng.normal(size=9)
        z = (r - problem.velocity(r) / np.repeat(problem.scales, 3)).reshape(-1, 3)
        slip = np.hypot(z[:, 1], z[:, 2]) > mu * z[:, 0]
        states |= [(z[:, 0] < 0).any(), (slip & (z[:, 0] > 0)).any(), (~slip).any()]
        J, h = fm.jacobian(problem, r, name).toarray(), 1e-7
        slope = np.column_stack(
            [(residual(problem, r + h * e) - residual(problem, r - h * e)) / (2 * h) for e in np.eye(9)]
        )
        # Curvature of order one times h² W² and round-off over h; a random point misses the kinks.
        np.testing.assert_allclose(J, slope, rtol=2e-5, atol=2e-5)
    assert states.all()


def test_partial_derivatives_of_the_bundle_s_equation(rng):
    """∂F/∂u and ∂F/∂r of (3.22) against differences, where none of its three kinks is near."""
    u, r, mu, rho, h = (
        rng.normal(size=(400, 3)),
        rng.normal(size=(400, 3)),
        np.full(400, 0.6),
        np.full((400, 1), 0.8),
        1e-6,
    )
    _, F_u, F_r = fm.xuewen_soh_wanji(u, r, mu, rho)
    cross, along = u[:, 1] * r[:, 2] - u[:, 2] * r[:, 1], (u[:, 1:] * r[:, 1:]).sum(axis=1)
    slack = mu * r[:, 0] - np.hypot(r[:, 1], r[:, 2]) - 0.8 * np.hypot(u[:, 1], u[:, 2])
    away = np.abs([cross, along, slack, 0.8 * u[:, 0] - r[:, 0]]).min(axis=0) > 1e-4
    assert away.sum() > 300
    for k, e in enumerate(np.eye(3)):
        f = fm.xuewen_soh_wanji
        for given, slope in (
            (F_u, (f(u + h * e, r, mu, rho)[0] - f(u - h * e, r, mu, rho)[0]) / (2 * h)),
            (F_r, (f(u, r + h * e, mu, rho)[0] - f(u, r - h * e, mu, rho)[0]) / (2 * h)),
        ):
            # Curvature 1/‖u_T‖, 1/‖r_T‖ of lengths that may be small, times h².
            np.testing.assert_allclose(given[away, :, k], slope[away], rtol=0, atol=1e-6)


def test_split_steps_in_the_jacobian(rng):
    A = rng.normal(size=(6, 6))
    problem = nd.FC3D(A @ A.T, rng.normal(size=6), np.array([0.3, 0.8]))
    rho, r, h = rng.uniform(0.05, 0.4, (2, 2)), np.array([1.0, 0.2, 0.1, 2.0, 3.0, 1.0]), 1e-7
    J = fm.jacobian(problem, r, "alart-curnier", rho).toarray()
    F = lambda x: fm.residual_alart_curnier(problem, x, rho)  # noqa: E731
    slope = np.column_stack([(F(r + h * e) - F(r - h * e)) / (2 * h) for e in np.eye(6)])
    np.testing.assert_allclose(J, slope, rtol=0, atol=1e-6)  # as above, W of order 10


@pytest.mark.parametrize("name", NAMES)
def test_partial_derivatives_split_the_identity(name, rng):
    """With u and r equally stiff (ρ = 1) F_r + F_u = I where nothing couples them: projections are nonexpansive."""
    u, r, mu = rng.normal(size=(200, 3)), rng.normal(size=(200, 3)), np.full(200, 0.7)
    _, F_u, F_r = fm.ELEMENTS[name](u, r, mu, np.ones((200, 2)))
    if name == "natural":
        # F_r = I - J with J the derivative of a projection: symmetric, eigenvalues in [0, 1].
        eigenvalues = np.linalg.eigvalsh(F_r)
        assert np.abs(F_r - F_r.transpose(0, 2, 1)).max() < 1e-14
        assert eigenvalues.min() > -1e-14 and eigenvalues.max() < 1 + 1e-14
    elif name == "fischer-burmeister":
        # ‖L_w⁻¹ L_x‖ ≤ 1 in the Lorentz algebra only for its spectrum: (w² - x² is in the cone) both parts stay below.
        scale = np.diag([1 / 0.7, 1.0, 1.0])
        spectrum = np.linalg.eigvals(np.eye(3) - F_r @ scale)
        assert np.abs(spectrum).max() < 1 + 1e-12
    else:
        np.testing.assert_allclose(F_u[:, 1:, 1:] + F_r[:, 1:, 1:], np.tile(np.eye(2), (200, 1, 1)), rtol=0, atol=1e-14)
        np.testing.assert_allclose(F_u[:, 0, 0] + F_r[:, 0, 0], 1.0)


def test_fischer_burmeister_is_zero_exactly_on_complementary_pairs(rng):
    """x = P(z), y = P(z) - z are complementary in the self-dual cone (Moreau): the function vanishes there.

    Where both are more than 0.1, 0.1 more of u_N makes x·y = 0.1 r_N, and the function at least a hundredth.
    """
    z, mu = rng.normal(size=(300, 3)), rng.uniform(0.2, 2.0, 300)
    r = cones.project(z, mu)
    hat = r - z  # in K*, orthogonal to r
    u = hat.copy()
    u[:, 0] -= mu * np.hypot(u[:, 1], u[:, 2])
    F = fm.ELEMENTS["fischer-burmeister"](u, r, mu, np.ones((300, 1)))[0]
    np.testing.assert_allclose(F, 0.0, rtol=0, atol=1e-7)  # root of round-off at the apex
    both = np.minimum(r[:, 0], np.linalg.norm(hat, axis=1)) > 0.1
    u[:, 0] += 0.1
    F = fm.ELEMENTS["fischer-burmeister"](u, r, mu, np.ones((300, 1)))[0]
    assert both.sum() > 100 and np.linalg.norm(F[both], axis=1).min() > 1e-2


@pytest.mark.parametrize("name", NAMES)
def test_a_contact_without_velocity_and_impulse_has_a_derivative(name):
    F, F_u, F_r = fm.ELEMENTS[name](np.zeros((1, 3)), np.zeros((1, 3)), np.array([0.5]), np.ones((1, 2)))
    assert not F.any() and np.isfinite(F_u).all() and np.isfinite(F_r).all()


def test_bad_arguments():
    problem = CASES["rest"]
    with pytest.raises(ValueError, match="rho must be positive"):
        fm.residual_natural_map(problem, problem.q, 0.0)
    with pytest.raises(ValueError, match="one number per contact"):
        fm.residual_natural_map(problem, problem.q, np.array([[1.0, 2.0]] * 4))
    with pytest.raises(ValueError, match="function must be one of"):
        fm.jacobian(problem, problem.q, "newton")
