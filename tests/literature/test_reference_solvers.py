"""The solvers of the literature on small problems: each at its reach, velocities against `auto`, their theorems."""

from itertools import islice
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp
from test_problem import corner_box
from test_solvers import CASES

import nsdyn as nd
from nsdyn.literature import bundle, formulations, interior_point, uzawa
from nsdyn.literature._common import Equilibrated, factor
from nsdyn.literature._frozen import shifted, slip_shift
from nsdyn.literature._kernels import one_contact
from nsdyn.literature.impulse_newton import ImpulseNewton, steps
from nsdyn.problem import cones

DATA = Path(__file__).resolve().parent.parent / "data"
REACH = 1e-6
NAMES = sorted(set(nd.solvers.SOLVERS) - {"auto", "newton", "pgs"})


@pytest.fixture(scope="module")
def velocities():
    return {name: nd.solve(problem, tol=1e-10).u for name, problem in CASES.items()}


def agrees(solution, u):
    assert solution.converged, solution.status.message
    # Ten times the tolerance over the stiffness of order 1; the velocity is unique in all cases.
    np.testing.assert_allclose(solution.u, u, rtol=0, atol=10 * REACH)


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("name", NAMES)
def test_solves(velocities, name, case):
    agrees(nd.solve(CASES[case], name, tol=REACH), velocities[case])


@pytest.mark.parametrize("rule", ["khobotov", "solodov-tseng"])
@pytest.mark.parametrize("solver", [nd.solvers.FixedPoint, nd.solvers.Extragradient])
def test_rules_of_the_step(velocities, solver, rule):
    for case, problem in CASES.items():
        agrees(solver(tol=REACH, rule=rule)(problem), velocities[case])


@pytest.mark.parametrize("search", ["goldstein-price", "armijo", "none"])
@pytest.mark.parametrize("function", ["alart-curnier", "fischer-burmeister", "jean-moreau", "natural"])
def test_newton_functions(velocities, function, search):
    for case, problem in CASES.items():
        agrees(ImpulseNewton(tol=REACH, function=function, search=search)(problem), velocities[case])


@pytest.mark.parametrize("rho", ["split", "condition"])
def test_rules_of_rho(velocities, rho):
    for case, problem in CASES.items():
        agrees(ImpulseNewton(tol=REACH, function="alart-curnier", rho=rho)(problem), velocities[case])


def test_rho_of_a_block_on_paper():
    """W_cc = diag(4, 2, 1): λ_max = 4, W_NN = 4, λ(W_TT) = 2, 1; the steps are returned times λ_max."""
    problem = nd.FC3D(np.diag([4.0, 2.0, 1.0]), np.ones(3), np.ones(1))
    expected = {"spectral": [1.0, 1.0], "split": [1.0, 2.0], "condition": [1.0, 1.0], "one": [4.0, 4.0]}
    for rule, rho in expected.items():
        np.testing.assert_allclose(steps(problem, rule), [rho], rtol=1e-15)


def test_newton_is_quadratic_near_the_solution():
    """Full steps on a definite problem from a near guess: three factorisations take 1e-3 to round-off."""
    problem = CASES["definite0"]
    r = nd.solve(problem, tol=1e-13).r
    solution = ImpulseNewton(tol=1e-12, function="alart-curnier")(problem, r + 1e-4)
    assert solution.converged and solution.iterations <= 3


def all_stick():
    """Box at rest pushed into the floor: every contact sticks. (csr, q, radius, r*, λ_max) at frozen bounds."""
    problem = corner_box(mu=0.5, push=(0.02, 0.01))[0]
    scaled = Equilibrated(problem)
    r = nd.solve(problem, tol=1e-13).r
    radius = problem.mu * r[::3]
    slack = radius - np.hypot(r[1::3], r[2::3])
    assert slack.min() > 0.01 and r[::3].min() > 0.1
    return scaled.csr, scaled.q, scaled.root[::3] * radius, scaled.root * r, np.linalg.eigvalsh(scaled.W.toarray())[-1]


def test_uzawa_is_monotone_just_below_its_bound():
    csr, q, radius, target, top = all_stick()
    start = target + 1e-3 * np.cos(np.arange(q.size))
    iterates = islice(uzawa.uzawa_iterates(csr, q, radius, 1.99 / top, start), 300)
    distance = np.array([np.linalg.norm(start - target), *(np.linalg.norm(r - target) for r in iterates)])
    # Non-expansive up to the rounding of numbers of order 1.
    assert (np.diff(distance) <= 1e-15).all() and distance[-1] < distance[0]


def test_uzawa_diverges_just_above_its_bound():
    csr, q, radius, target, top = all_stick()
    A = np.zeros((q.size, q.size))
    for c in range(csr[0].size - 1):
        for p in range(csr[0][c], csr[0][c + 1]):
            A[3 * c : 3 * c + 3, 3 * csr[1][p] : 3 * csr[1][p] + 3] = csr[2][p]
    worst = np.linalg.eigh(A)[1][:, -1]
    start = target + 1e-8 * worst  # small against the slack of the cones: the map is linear at first
    iterates = list(islice(uzawa.uzawa_iterates(csr, q, radius, 2.02 / top, start), 2000))
    distance = np.array([np.linalg.norm(r - target) for r in iterates])
    # Grows by 2 % an iteration until a projection catches it, and does not come back.
    np.testing.assert_allclose(distance[50] / distance[0], 1.02**50, rtol=1e-3)
    assert distance[-100:].min() > 1e3 * distance[0]


@pytest.mark.parametrize("case", CASES)
def test_interior_point_solves_the_convex_problem(case, rng):
    """KKT of the frozen problem: x ∈ K, W x + q + s ∈ K*, orthogonal; also for an unsymmetric monotone W."""
    A = rng.normal(size=(12, 12))
    skew = nd.FC3D(CASES["definite0"].W.toarray() + 0.3 * (A - A.T), CASES["definite0"].q, CASES["definite0"].mu)
    for problem in (CASES[case], skew):
        scaled = Equilibrated(problem)
        q = shifted(scaled, slip_shift(scaled, rng.uniform(size=scaled.q.size)))
        x, count = interior_point.minimise(scaled, q, 1e-10)
        frozen = cones.project((x - scaled.W @ x - q).reshape(-1, 3), problem.mu).ravel()
        np.testing.assert_allclose(frozen, x, rtol=0, atol=1e-9)
        assert count <= 30


def test_shortest_vector_of_a_hull():
    """Segment from (1, 1) to (1, -1): nearest to 0 is its middle; a triangle around 0 holds it; the norm is free."""
    for scale in (1e-9, 1.0, 1e9):
        V = scale * np.array([[1.0, 1.0], [1.0, -1.0]])
        np.testing.assert_allclose(bundle.shortest(V) @ V, [scale, 0.0], rtol=1e-12, atol=1e-12 * scale)
    around = np.array([[1.0, 0.0], [-1.0, 1.0], [-1.0, -1.0]])
    np.testing.assert_allclose(bundle.shortest(around) @ around, 0.0, rtol=0, atol=1e-15)


@pytest.mark.parametrize("function", sorted(formulations.ELEMENTS))
def test_bundle_solves_one_contact(function):
    """One contact that sticks and one that slides: the merits lead to the solution of the closed form."""
    for push in (0.1, 2.0):
        problem = nd.FC3D(np.diag([1.0, 2.0, 2.0]), np.array([-1.0, push, 0.5 * push]), np.array([0.5]))
        exact = nd.solve(problem, tol=1e-13)
        solution = nd.solvers.Bundle(tol=REACH, function=function)(problem)
        agrees(solution, exact.u)


def test_bundle_on_the_paper_s_equation():
    """A box at rest and a sliding contact, from zero and from the paper's start, where everything sticks."""
    solver = nd.solvers.Bundle(tol=REACH, function="xuewen-soh-wanji", max_iter=500)
    assert solver(corner_box()[0]).converged
    sliding = nd.FC3D(np.diag([1.0, 2.0, 2.0]), np.array([-1.0, 2.0, 1.0]), np.array([0.5]))
    u = nd.solve(sliding, tol=1e-12).u
    for start in (None, np.array([1.0, -1.0, -0.5])):
        agrees(solver(sliding, start), u)


def test_a_stationary_point_of_clarke_from_which_it_goes_down():
    """The paper's theorem 2.1 takes 0 ∈ ∂φ for φ'(·; h) ≥ 0; φ = ½‖F‖² of its equation is concave across r_T = 0."""
    sliding = nd.FC3D(np.diag([1.0, 2.0, 2.0]), np.array([-1.0, 2.0, 1.0]), np.array([0.5]))

    def phi(r):
        return 0.5 * float((formulations.residual_xuewen_soh_wanji(sliding, r, 1.0) ** 2).sum())

    ridge, h = np.array([0.8, 0.0, 0.0]), 1e-7
    mean = np.zeros(3)  # of the gradients around the kink: an element of Clarke's hull
    for angle in 2 * np.pi * np.arange(360) / 360:
        x = ridge + 1e-5 * np.array([0.0, np.cos(angle), np.sin(angle)])
        mean += [(phi(x + h * e) - phi(x - h * e)) / (2 * h) for e in np.eye(3)]
    # The third line contributes of the order of the circle's radius times the slip, 3e-5; differences round to 1e-9.
    np.testing.assert_allclose(mean / 360, 0.0, rtol=0, atol=1e-4)
    down = np.array([0.0, -2.0, -1.0]) / np.sqrt(5.0)
    assert (phi(ridge + h * down) - phi(ridge)) / h == pytest.approx(-0.4, abs=1e-5)


def test_admm_and_proximal_on_redundant_contacts():
    """W of rank 6 in 12 and a tight tolerance: what the methods are for."""
    problem = corner_box(mu=0.1, push=(0.5, 0.2))[0]
    for solver in (nd.solvers.ADMM(tol=1e-10), nd.solvers.Proximal(tol=1e-12)):
        assert solver(problem).converged


def test_anderson_needs_no_more_passes():
    """The shift of a stiffly coupled problem contracts slowly; acceleration may not cost sweeps."""
    problem = CASES["definite1"]
    plain, accelerated = (nd.solvers.ACLM(tol=1e-10, memory=m)(problem) for m in (0, 5))
    assert plain.converged and accelerated.converged and accelerated.iterations <= plain.iterations


@pytest.mark.parametrize("name", NAMES)
def test_no_contacts_and_one_iteration(name):
    solver = nd.solvers.SOLVERS[name]
    empty = solver()(nd.FC3D(np.zeros((0, 0)), np.zeros(0), np.zeros(0)))
    assert empty.converged and empty.r.size == 0
    short = solver(tol=1e-30, max_iter=1)(CASES["definite2"])
    assert not short.converged and np.isfinite(short.r).all()


def test_steps_that_split_the_cone_need_two():
    with pytest.raises(ValueError, match="splits the cone"):
        nd.solvers.ImpulseNewton(function="natural", rho="split")


@pytest.mark.parametrize("contacts", [5, 60])
def test_largest_eigenvalue_is_a_bound(contacts, rng):
    """Below 100 rows exact, above by Lanczos: never too small, at most 0.2 % too large; W need not be symmetric."""
    A = rng.normal(size=(3 * contacts, 3 * contacts))
    problem = nd.FC3D(A @ A.T + A - A.T, rng.normal(size=3 * contacts), np.ones(contacts))
    scaled = Equilibrated(problem)
    exact = np.linalg.eigvalsh(0.5 * (scaled.W + scaled.W.T).toarray())[-1]
    assert exact * (1 - 1e-14) <= scaled.largest_eigenvalue() <= 1.002 * exact


def test_equilibrated_problem_is_the_same_problem(rng):
    """Diagonal blocks of norm 1, and its velocity is that of the problem times S^-½."""
    problem = CASES["definite2"]
    scaled, r = Equilibrated(problem), rng.normal(size=12)
    np.testing.assert_allclose(nd.FC3D(scaled.W, scaled.q, scaled.mu).scales, 1.0, rtol=1e-12)
    u = scaled.W @ (scaled.root * r) + scaled.q
    np.testing.assert_allclose(u * scaled.root, problem.velocity(r), rtol=1e-12, atol=1e-12)


def test_over_relaxation(velocities):
    for case, problem in CASES.items():
        agrees(nd.solvers.ADMM(tol=REACH, relaxation=1.6)(problem), velocities[case])


@pytest.mark.parametrize("local", ["projection", "iterated-projection", "exact", *formulations.ELEMENTS])
def test_local_solvers(velocities, local):
    for case, problem in CASES.items():
        agrees(nd.solvers.GaussSeidel(tol=REACH, local=local)(problem), velocities[case])


@pytest.mark.parametrize("order", ["given", "shuffled", "reshuffled", "symmetric"])
@pytest.mark.parametrize("omega", [0.6, 1.3])
def test_orders_and_relaxation(velocities, order, omega):
    for case, problem in CASES.items():
        solver = nd.solvers.GaussSeidel(tol=REACH, order=order, omega=omega)
        agrees(solver(problem), velocities[case])
        np.testing.assert_array_equal(solver(problem).r, solver(problem).r)  # shuffles are seeded


def test_fixed_point_of_the_relaxed_sweep_is_the_solution():
    """A sweep of any ω leaves the solution where it is: the splitting is consistent."""
    problem = CASES["definite0"]
    scaled = Equilibrated(problem)
    x = nd.solve(problem, tol=1e-13).r * scaled.root
    for omega in (0.4, 1.0, 1.9):
        y, order = x.copy(), np.arange(problem.nc)
        one_contact.sweep(scaled.csr, scaled.q, scaled.mu, order, one_contact.EXACT, omega, (1e-14, 50), y)
        np.testing.assert_allclose(y, x, rtol=0, atol=1e-11)


def test_exact_local_solver_against_the_roots_of_the_quartic(rng):
    """Slip: u_N = 0, u_T = -α r_T, ‖r_T‖ = μ r_N is a quartic in α; what `coulomb` finds is one of its roots."""
    slips = 0
    for _ in range(60):
        G = rng.normal(size=(3, 3))
        W, mu, q = G @ G.T + 0.1 * np.eye(3), rng.uniform(0.1, 1.0), rng.normal(size=3) * [1, 3, 3]
        r = np.zeros(3)
        one_contact.solve(one_contact.EXACT, W, q, mu, 1.0, 0.0, 1, r)
        u = W @ r + q
        if r[0] < 1e-6 or np.hypot(*u[1:]) < 1e-6:
            continue
        slips += 1

        def lines(alpha, W=W, q=q):
            S = W + np.diag([0.0, alpha, alpha])
            return np.linalg.det(S), np.linalg.det(S) * np.linalg.solve(S, -q)

        # det(S)² (‖r_T‖² - μ² r_N²), a polynomial of degree 4 through 5 points.
        at = np.linspace(0.0, 4.0, 5)
        values = [x[1] ** 2 + x[2] ** 2 - (mu * x[0]) ** 2 for x in (lines(a)[1] for a in at)]
        alpha = -(u[1:] @ r[1:]) / (r[1:] @ r[1:])
        roots = np.roots(np.polyfit(at, values, 4))
        assert np.abs(roots - alpha).min() <= 1e-6 * max(1.0, alpha)  # the fit loses half of the digits
    assert slips > 20


@pytest.mark.parametrize("function", ["alart-curnier", "natural"])
def test_hybrid_solves_where_newton_wanders(function):
    """Rope around a drum: of full steps from zero round-off decides whether 22 or 200 do; after 100 safe ones a few."""
    problem = nd.fclib.read(DATA / "capstan.hdf5")
    assert not ImpulseNewton(tol=REACH, max_iter=15, function=function)(problem).converged
    solution = nd.solvers.Hybrid(tol=REACH, function=function)(problem)
    assert solution.converged and 100 < solution.iterations <= 110
    for other in formulations.ELEMENTS:
        assert nd.solvers.Hybrid(tol=REACH, function=other)(CASES["definite1"]).converged


@pytest.mark.parametrize("sigma", [1e-2, 1.0, pytest.param(1e2, marks=pytest.mark.slow)])
@pytest.mark.parametrize("nu", [0.5, 1.0])
def test_proximal_by_the_error(velocities, sigma, nu):
    for case, problem in CASES.items():
        agrees(nd.solvers.Proximal(tol=REACH, rule="error", alpha=sigma, nu=nu)(problem), velocities[case])


@pytest.mark.parametrize("case", CASES)
def test_convex_relaxation(case):
    """r ∈ K, W r + q ∈ K*, orthogonal; where nothing slides it is the solution of Coulomb's law."""
    problem = CASES[case]
    r = nd.solvers.relaxed(problem, tol=1e-12)
    u = problem.velocity(r).reshape(-1, 3)
    x = r.reshape(-1, 3)
    for given, projected in ((x, cones.project(x, problem.mu)), (u, cones.project_dual(u, problem.mu))):
        np.testing.assert_allclose(given, projected, rtol=0, atol=1e-9)
    assert abs(r @ u.ravel()) <= 1e-9
    if case in ("rest", "stop"):
        assert problem.error(r) <= 1e-9
    if case == "slip":  # dilation: it opens at mu |u_T|
        assert problem.error(r) > 1e-3
        np.testing.assert_allclose(u[:, 0], problem.mu * np.hypot(u[:, 1], u[:, 2]), rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", ["admm", "uzawa"])
def test_iterates_that_diverge_are_told_by_the_status_alone(name):
    """A W so unsymmetric that impulses overflow within the iterations allowed; NumPy's warnings would be errors."""
    rng = np.random.default_rng(20)
    A = rng.normal(size=(6, 6))
    W = A @ A.T + 3.0 * np.triu(rng.normal(size=A.shape), 1)
    solver = nd.solvers.SOLVERS[name](max_iter=3000)
    solution = nd.solve(nd.FC3D(W, rng.normal(size=6), [2.0, 2.0]), solver)
    assert solution.status is nd.Status.MAX_ITERATIONS and np.isfinite(solution.r).all()


@pytest.mark.parametrize("form", [np.array, sp.csr_array])
def test_singular_matrix_has_no_solve(form):
    assert factor(form(np.diag([1.0, 0.0, 1.0]))) is None
    np.testing.assert_allclose(factor(form(np.diag([1.0, 2.0, 4.0])))(np.ones(3)), [1.0, 0.5, 0.25])
