"""FC3D: its measures, their invariances, bad input; block factors against dense algebra."""

import numpy as np
import pytest
import scipy.sparse as sp
from extended import project

import nsdyn as nd
from nsdyn.problem import gauss, polished
from nsdyn.problem.blocks import DelassusFactors

BOX = 4  # contacts of the four-corner box below


def corner_box(mu=0.5, push=(0.0, 0.0)):
    """Box of 1 kg, side 2 on its four lower corners under one second of unit gravity: redundant, W of rank 6 in 12."""
    M = np.diag([1.0, 1.0, 1.0, 2 / 3, 2 / 3, 2 / 3])
    H = np.zeros((6, 12))
    for c, (x, y) in enumerate([(-1, -1), (1, -1), (1, 1), (-1, 1)]):
        for i, d in enumerate([(0, 0, 1), (1, 0, 0), (0, 1, 0)]):
            H[:3, 3 * c + i], H[3:, 3 * c + i] = d, np.cross((x, y, -1), d)
    v = np.array([push[0], push[1], -1.0, 0, 0, 0])
    return nd.FC3D(H.T @ np.linalg.solve(M, H), H.T @ v, np.full(BOX, mu)), M, H


def one_block(H):
    """The factors M = I and H (n, 3 nc), all coordinates in one block."""
    n, nc = H.shape[0], H.shape[1] // 3
    block, start = np.full((nc, 2), -1), np.zeros((nc, 2), np.int64)
    block[:, 0], start[:, 0] = 0, 3 * n * np.arange(nc)
    eye = np.eye(n).ravel()
    return DelassusFactors(np.array([0, n]), block, start, H.T.ravel(), np.array([0]), eye, eye)


def test_solution_on_paper():
    problem, _, _ = corner_box()
    r = np.tile([0.25, 0.0, 0.0], BOX)
    # Numbers of order 1.
    assert problem.error(r) < 1e-15 and problem.residual(r) < 1e-15 and problem.gap(r) < 1e-15


def test_slip_on_paper():
    problem, _, _ = corner_box(mu=0.1, push=(0.5, 0.0))
    # mu = 0.1 takes 0.1 from the speed 0.5; the pressure moves forward by mu times the height of the centre.
    r = np.array([[n, -0.1 * n, 0.0] for n in (0.225, 0.275, 0.275, 0.225)]).ravel()
    assert problem.residual(r) < 1e-15
    np.testing.assert_allclose(problem.velocity(r).reshape(-1, 3), [[0, 0.4, 0]] * BOX, rtol=0, atol=1e-15)


@pytest.mark.parametrize("factor", [1e-6, 1e6])
def test_residual_does_not_change_with_the_unit_of_mass(factor, rng):
    problem, _, _ = corner_box()
    r = rng.uniform(0, 1, 12)
    scaled = nd.FC3D(problem.W / factor, problem.q, problem.mu)
    assert scaled.residual(r * factor) == pytest.approx(problem.residual(r), rel=1e-12)


def test_error_is_the_formula(rng):
    problem, _, _ = corner_box()
    r = rng.normal(size=12)
    u = (problem.W @ r + problem.q).reshape(-1, 3)
    from nsdyn.problem import cones

    z = (r.reshape(-1, 3) - cones.saxce(u, problem.mu)).astype(np.longdouble)
    projected = np.array([project(z[c], mu)[0] for c, mu in enumerate(problem.mu)]).ravel().astype(float)
    expected = np.linalg.norm(r - projected) / np.linalg.norm(problem.q)
    assert problem.error(r) == pytest.approx(expected, rel=1e-13)


@pytest.mark.parametrize("mu", [0.0, 1.0, 1e6, 1e20, 1e300])
def test_a_contact_that_closes_is_not_solved_however_rough_it_is(mu):
    """The distance of û from K* is 1/μ of the velocity at which contacts that slip close."""
    rng = np.random.default_rng(4)
    H = rng.normal(size=(12, 12))
    problem = nd.FC3D(H.T @ H / 4 + np.eye(12), rng.normal(size=12) - np.tile([1.0, 0, 0], 4), np.full(4, mu))
    assert problem.q[0] < -1.0 and problem.residual(np.zeros(12)) >= -problem.q[0::3].min()
    solution = nd.solve(problem, tol=1e-4)
    assert not solution.converged or solution.u[0::3].min() >= -1e-4


@pytest.mark.slow
def test_gap_bounds_the_velocity_error(rng):
    """½|v - v*|²_M <= gap for any r in K with u_N >= 0, against a frozen problem solved by an independent method."""
    from scipy.optimize import minimize

    from nsdyn.problem import cones

    problem, M, H = corner_box(mu=0.3, push=(0.2, 0.1))
    v_free = np.array([0.2, 0.1, -1.0, 0, 0, 0])
    for _ in range(5):
        r = cones.project(np.tile([0.26, 0, 0], (BOX, 1)) + 0.02 * rng.normal(size=(BOX, 3)), problem.mu).ravel()
        u = problem.velocity(r)
        certificate = gauss.certify(problem, r, u)[0]
        shift = problem.mu * np.hypot(u[1::3], u[2::3])
        lift = np.maximum(0.0, -u[0::3])

        def constraint(v, shift=shift, lift=lift):
            w = H.T @ v
            return w[0::3] + lift + shift - problem.mu * np.sqrt(w[1::3] ** 2 + w[2::3] ** 2 + 1e-18)

        best = minimize(
            lambda v: 0.5 * (v - v_free) @ M @ (v - v_free),
            v_free + np.linalg.solve(M, H @ r),
            constraints={"type": "ineq", "fun": constraint},
            method="SLSQP",
            options={"ftol": 1e-14, "maxiter": 500},
        )
        v = v_free + np.linalg.solve(M, H @ r)
        # SLSQP's own accuracy.
        assert 0.5 * (v - best.x) @ M @ (v - best.x) <= certificate.gap + 1e-7


def test_blocks_against_dense(rng):
    """H, M⁻¹ and W of random blocks of different sizes, fixed sides and driven trees included; W is symmetric."""
    sizes, nc = np.array([6, 3, 6, 7, 0]), 10
    offset = np.concatenate(([0], np.cumsum(sizes)))
    block = np.array([[0, 1], [1, -1], [-1, 2], [2, 3], [3, 0], [0, -1], [1, 2], [3, -1], [0, 1], [4, 2]])
    start, h = np.zeros((nc, 2), np.int64), []
    for c in range(nc):
        for s in range(2):
            start[c, s] = sum(x.size for x in h)
            if block[c, s] >= 0:
                h.append(rng.normal(size=3 * sizes[block[c, s]]))
    m = []
    for n in sizes:
        A = rng.normal(size=(n, n))
        m.append(A @ A.T + n * np.eye(n))
    inverses = [np.linalg.inv(x) for x in m]
    blocks = DelassusFactors(
        offset,
        block,
        start,
        np.concatenate(h),
        np.concatenate(([0], np.cumsum(sizes**2)))[:-1],
        np.concatenate([x.ravel() for x in m]),
        np.concatenate([0.5 * (x + x.T).ravel() for x in inverses]),
    )
    M, H = blocks.dense()
    W = blocks.delassus()
    # Round-off of sums of about ten terms of order 1.
    np.testing.assert_allclose(W.toarray(), H.T @ np.linalg.solve(M, H), rtol=0, atol=1e-13)
    np.testing.assert_array_equal(W.toarray(), W.toarray().T)
    assert sp.bsr_array(W).has_sorted_indices or (np.diff(W.indices[: W.indptr[1]]) > 0).all()
    v, r = rng.normal(size=offset[-1]), rng.normal(size=3 * nc)
    np.testing.assert_allclose(blocks.relative_velocity(v), H.T @ v, rtol=0, atol=1e-14)
    np.testing.assert_allclose(blocks.velocity_change(r), np.linalg.solve(M, H @ r), rtol=0, atol=1e-13)
    expected = [np.linalg.eigvalsh(W.toarray()[3 * c : 3 * c + 3, 3 * c : 3 * c + 3])[-1] for c in range(nc)]
    problem = nd.FC3D.from_blocks(blocks, np.zeros(3 * nc), np.ones(nc))
    np.testing.assert_allclose(problem.scales, expected, rtol=1e-13)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"W": np.eye(6)[:, :5]}, "W must be square"),
        ({"W": np.eye(5)}, "W must be square"),
        ({"W": np.eye(3) * (1 + 1j)}, r"W must be real and square with 3 rows per contact, got "),
        ({"W": sp.csr_array(np.eye(3) * (1 + 1j))}, "W must be real, got complex numbers"),
        ({"q": np.array([-1.0, 1j, 0.0])}, r"q must be 3 numbers per contact, got "),
        ({"W": {}}, r"W must be real and square with 3 rows per contact, got \{\}"),
        ({"q": "fast"}, "q must be 3 numbers per contact, got 'fast'"),
        ({"mu": [None, "x"]}, r"mu must be a number per contact, got \[None, 'x'\]"),
        ({"W": np.full((6, 6), np.nan)}, "W must be finite"),
        ({"W": np.zeros((6, 6))}, "diagonal block"),
        ({"W": np.eye(3)}, "W must have 6 rows"),
        ({"q": np.zeros(5)}, "q must have 3 entries"),
        ({"q": np.array([np.inf, 0, 0, 0, 0, 0])}, "q must be finite"),
        ({"q": np.array([-1e160, 0, 0, 0, 0, 0])}, "q must have a norm whose square is finite, got 1e"),
        ({"mu": np.array([-0.1, 0.5])}, "mu must be finite and not negative, got -0.1"),
        ({"mu": np.array([np.nan, 0.5])}, "mu must be finite and not negative"),
    ],
)
def test_bad_input(change, words):
    good = {"W": np.eye(6), "q": np.ones(6), "mu": np.array([0.5, 0.5])}
    with pytest.raises(ValueError, match=words):
        nd.FC3D(**good | change)


@pytest.mark.parametrize("factors", [False, True])
@pytest.mark.parametrize("r", [np.zeros(11), np.zeros(0), np.zeros((4, 3)), np.zeros(13)])
def test_impulses_of_another_length_are_refused(factors, r):
    """Kernels would read what lies beside them: a velocity of [1e80, -1e-138, ...] m/s, and no word of it."""
    problem, M, H = corner_box()
    if factors:
        problem = nd.FC3D.from_blocks(one_block(np.linalg.solve(np.linalg.cholesky(M), H)), problem.q, problem.mu)
    of = (
        *(getattr(problem, name) for name in "velocity product error residual gap round_off".split()),
        *(lambda r, certify=one.certify: certify(problem, r) for one in (gauss, polished)),
    )
    for measured in of:
        with pytest.raises(ValueError, match=r"r must have shape \(12,\) like q, got"):
            measured(r)


def test_impulses_may_be_any_sequence_of_numbers():
    problem, _, _ = corner_box()
    r = [1.0, 0.0, 0.0] * BOX
    assert (problem.velocity(r) == problem.W @ r + problem.q).all()
    assert np.abs(problem.product(r) - problem.W @ r).max() <= 1e-15


def test_other_velocities_are_of_the_same_contacts():
    problem, _, _ = corner_box()
    with pytest.raises(ValueError, match="q must have 12 entries, 3 per contact of W, got 15"):
        problem.with_velocity(np.zeros(15), np.zeros(5))


def test_empty_problem_is_solved():
    problem = nd.FC3D(np.zeros((0, 0)), np.zeros(0), np.zeros(0))
    assert nd.solve(problem).converged


def test_a_problem_keeps_its_own_numbers():
    """What it was made from may change afterwards, without a word to it."""
    W, q, mu = sp.bsr_array(np.diag([2.0, 1.0, 1.0]), blocksize=(3, 3)), np.array([-1.0, 3.0, 0.0]), np.array([0.5])
    problem = nd.FC3D(W, q, mu)
    before = nd.solve(problem)
    W.data *= 1e3
    q *= 1e-9
    mu -= 1.0
    after = nd.solve(problem)
    np.testing.assert_array_equal(after.r, before.r)
    assert problem.error(np.zeros(3)) > 0.2


def test_blocks_that_are_given_twice_add_up():
    twice = np.stack([np.diag([1.0, 2.0, 1.0]), np.eye(3)])
    W = sp.bsr_array((twice, np.zeros(2, int), np.array([0, 2])), shape=(3, 3))
    problem = nd.FC3D(W, [-1.0, 3.0, 0.0], [0.5])
    np.testing.assert_array_equal(problem.W.toarray(), np.diag([2.0, 3.0, 2.0]))
    assert W.nnz == 18  # as it was given


@pytest.mark.parametrize("size", [(1, 1), (2, 3), (6, 6)])
def test_blocks_of_any_size(size, rng):
    A = rng.normal(size=(6, 6))
    problem = nd.FC3D(sp.bsr_array(A @ A.T, blocksize=size), np.ones(6), np.ones(2))
    assert np.array_equal(problem.W.toarray(), A @ A.T)


@pytest.mark.parametrize("kind", [np.int8, np.float32, np.longdouble])
def test_sparse_matrices_of_any_numbers(kind):
    """Kernels take doubles: of no other type are they compiled, and of some they cannot be."""
    problem = nd.FC3D(sp.csr_array(np.diag([2, 1, 1]).astype(kind)), [-1.0, 3.0, 0.0], [0.5])
    assert problem.W.dtype == np.float64 and nd.solve(problem).converged
