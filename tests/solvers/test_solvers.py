"""Every solver on every small problem, judged by the problem; agreement in velocities, never in impulses."""

import re
from dataclasses import dataclass, field, fields

import numpy as np
import pytest
from test_problem import corner_box

import nsdyn as nd
from nsdyn._kernels.problem import sparse as matrix
from nsdyn.literature._kernels import anderson
from nsdyn.literature._kernels import pgs as sweeps
from nsdyn.problem import operators
from nsdyn.solvers.nesterov import Sweeps
from nsdyn.solvers.newton import PENALTY, newton
from nsdyn.tools.options import Options


def cases():
    rng = np.random.default_rng(7)
    yield "rest", corner_box()[0]
    yield "slip", corner_box(mu=0.1, push=(0.5, 0.2))[0]
    yield "stop", corner_box(mu=0.6, push=(0.3, -0.4))[0]
    yield "frictionless", corner_box(mu=0.0, push=(0.5, 0.2))[0]
    yield "lift", nd.FC3D(np.eye(6), np.array([1.0, 0.3, 0.1, 0.5, 0.0, 0.0]), np.array([0.3, 0.3]))
    for k in range(3):
        A = rng.normal(size=(12, 12))
        yield f"definite{k}", nd.FC3D(A @ A.T + np.eye(12), rng.normal(size=12), rng.uniform(0.1, 0.8, 4))


CASES = dict(cases())


@pytest.mark.parametrize("name", CASES)
def test_solves(solver, name):
    problem = CASES[name]
    solution = solver(problem)
    assert solution.converged, solution.status.message
    assert problem.error(solution.r) <= 1e-8 and problem.residual(solution.r) <= 1e-8
    np.testing.assert_allclose(solution.u, problem.W @ solution.r + problem.q, rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", CASES)
def test_velocities_agree(name):
    problem = CASES[name]
    u = [nd.solve(problem, s, tol=1e-9).u for s in ("pgs", "newton", "auto")]
    # The corner box has one velocity although not one impulse; ten times the tolerance over the stiffness of order 1.
    np.testing.assert_allclose(u[1], u[0], rtol=0, atol=1e-7)
    np.testing.assert_allclose(u[2], u[0], rtol=0, atol=1e-7)


def test_exact_guess_costs_nothing(solver):
    problem = corner_box()[0]
    r = np.tile([0.25, 0.0, 0.0], 4)
    solution = solver(problem, r)
    assert solution.iterations == 0 and (solution.r == r).all()


@pytest.mark.parametrize("factor", [1e-6, 1e6])
def test_scaled_mass(factor):
    problem = corner_box(mu=0.1, push=(0.5, 0.2))[0]
    scaled = nd.FC3D(problem.W / factor, problem.q, problem.mu)
    np.testing.assert_allclose(nd.solve(scaled).u, nd.solve(problem).u, rtol=0, atol=1e-8)


def test_permuted_contacts_give_the_same_velocity(rng):
    problem = corner_box(mu=0.1, push=(0.5, 0.2))[0]
    order = rng.permutation(4)
    rows = (3 * order[:, None] + np.arange(3)).ravel()
    W = problem.W.toarray()[np.ix_(rows, rows)]
    u = nd.solve(nd.FC3D(W, problem.q[rows], problem.mu[order])).u
    np.testing.assert_allclose(u, nd.solve(problem).u[rows], rtol=0, atol=1e-8)


def test_failure_is_a_status_not_an_exception():
    problem = corner_box(mu=0.1, push=(0.5, 0.2))[0]
    solution = nd.solvers.PGS(tol=1e-14, max_iter=1, memory=0)(problem)
    assert solution.status is nd.Status.MAX_ITERATIONS and not solution.converged
    assert "limit" in solution.status.message


def test_warm_newton_is_quick():
    """All contacts stick and the guess is near: the states are found at once, the penalty grows to finish."""
    problem = corner_box()[0]
    guess = np.tile([0.25, 0.0, 0.0], 4) + 1e-3
    assert nd.solve(problem, "newton", r0=guess).iterations <= 6


def test_newton_keeps_its_digits_with_large_penalties():
    """A column of 100 boxes bends 1e8 times softer than a contact: Newton needs penalties as large, and solves it.

    Whole velocities, of 0.1 m/s, would be rounded by 1e-17 and leave that times the penalties: 1e-9 m/s at the best.
    """
    problem = nd.Stepper(nd.scenes.load("stack")(height=100), 1e-2).step().problem
    r = np.zeros_like(problem.q)
    Sweeps(problem, r).run(1e-8, 1280, 1280)
    used, measure = newton(problem, operators.operator(problem), r, 1e-12, PENALTY, 72)
    assert measure <= 1e-12 and used < 72
    assert problem.solved(r, 1e-12)[0]


def test_sweep_against_its_definition(rng):
    """One sweep in NumPy: contacts in order, each solved alone with the others frozen."""
    problem = CASES["definite0"]
    r = rng.uniform(0, 0.1, 12)
    expected, W = r.copy(), problem.W.toarray()
    for c in range(4):
        i = slice(3 * c, 3 * c + 3)
        q = problem.q[i] + W[i] @ expected - W[i, i] @ expected[i]
        one = nd.FC3D(W[i, i], q, problem.mu[c : c + 1])
        expected[i] = nd.solve(one, tol=1e-13).r
    sweeps.sweep_matrix(sweeps.matrix(*problem.csr), problem.q, problem.mu, r)
    np.testing.assert_allclose(r, expected, rtol=0, atol=1e-11)


def test_sweep_by_factors_is_the_sweep_by_matrix(rng):
    """Both forms of W, on the contacts of a real step; v = M⁻¹ H r is kept up to date."""
    problem = nd.Stepper(nd.scenes.load("pyramid")(base=3), dt=1e-2).step().problem
    blocks = problem.blocks
    W = sweeps.factors(blocks.arrays)
    np.testing.assert_allclose(W.diagonal, problem.W.toarray().reshape(blocks.nc, 3, blocks.nc, 3)[
        np.arange(blocks.nc), :, np.arange(blocks.nc)
    ], rtol=0, atol=1e-13)  # fmt: skip
    r = rng.uniform(-0.01, 0.1, 3 * blocks.nc)
    expected, v = r.copy(), blocks.velocity_change(r)
    for _ in range(3):
        sweeps.sweep_matrix(sweeps.matrix(*problem.csr), problem.q, problem.mu, expected)
        sweeps.sweep_factors(W, problem.q, problem.mu, v, r)
    np.testing.assert_allclose(r, expected, rtol=0, atol=1e-13)  # round-off of impulses below 1
    np.testing.assert_allclose(v, blocks.velocity_change(r), rtol=0, atol=1e-13)


def test_newton_matrix_dense_and_sparse(rng):
    """Both layouts of K = M + Σ H A Hᵀ against dense algebra, on the contacts of a real step."""
    stepper = nd.Stepper(nd.scenes.load("pyramid")(base=3), dt=1e-2)
    blocks = stepper.step().problem.blocks
    M, H = blocks.dense()
    A = rng.normal(size=(blocks.nc, 3, 3))
    expected = M.copy()
    for c in range(blocks.nc):
        rows = H[:, 3 * c : 3 * c + 3]
        expected += rows @ A[c] @ rows.T
    indptr, slot, diagonal = matrix.dense_pattern(blocks.offset, blocks.block)
    K = np.empty((blocks.n, blocks.n))
    matrix.assemble(blocks.arrays, A, indptr, blocks.offset, slot, diagonal, K.ravel())
    np.testing.assert_allclose(K, expected, rtol=0, atol=1e-12)
    indptr, indices, slot, diagonal = operators.pattern(blocks.offset, blocks.block)
    data = np.empty(indices.size)
    matrix.assemble(blocks.arrays, A, indptr, blocks.offset[:-1], slot, diagonal, data)
    import scipy.sparse as sp

    sparse = sp.csr_array((data, indices, indptr), shape=K.shape)
    np.testing.assert_allclose(sparse.toarray(), expected, rtol=0, atol=1e-12)


def test_factorisations_by_blocks_and_by_w(rng):
    """K⁻¹ b and W (I + A W)⁻¹ g against dense algebra; a graph that was factorised before gives the same bits."""
    problem = nd.Stepper(nd.scenes.load("pyramid")(base=4), dt=1e-2).step().problem
    blocks, W = problem.blocks, problem.W.toarray()
    M, H = blocks.dense()
    A = rng.normal(size=(blocks.nc, 3, 3)) + 3.0 * np.eye(3)
    wide = np.zeros_like(W)
    for c in range(blocks.nc):
        wide[3 * c : 3 * c + 3, 3 * c : 3 * c + 3] = A[c]
    b, g = rng.normal(size=blocks.n), rng.normal(size=W.shape[0])
    graph = operators.Factor(blocks.offset, blocks.block)
    x = graph.factor(blocks, A)(b)
    np.testing.assert_allclose(x, np.linalg.solve(M + H @ wide @ H.T, b), rtol=1e-9, atol=1e-10)
    even = A + A.transpose(0, 2, 1)
    np.testing.assert_allclose(
        graph.factor(blocks, even)(b), np.linalg.solve(M + H @ (wide + wide.T) @ H.T, b), rtol=1e-9, atol=1e-10
    )
    expected = W @ np.linalg.solve(np.eye(W.shape[0]) + wide @ W, g)
    for operator in (operators.Velocity(blocks), operators.Local(problem.W)):
        first = operator.factor(A)(g)
        np.testing.assert_allclose(first, expected, rtol=1e-8, atol=1e-10)
        operator.factor(even)(g)
        np.testing.assert_array_equal(operator.factor(A)(g), first)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"solver": "magic"}, r"solver must be one of .*, pgs, .*; got 'magic'"),
        *(({"tol": tol}, f"tol must be positive and finite, got {tol!r}") for tol in (0.0, -1, np.nan, np.inf, "a")),
        ({"problem": np.eye(3)}, r"problem must be a nsdyn\.FC3D, got ndarray"),
    ],
)
def test_what_is_no_problem_no_solver_or_no_tolerance_is_told(given, message):
    with pytest.raises(ValueError, match=message):
        nd.solve(**{"problem": CASES["rest"], **given})


NONE = {
    str: ("zz", 3, np.nan, None, True),
    int: (-1, 0.5, np.nan, np.inf, "zz", None, True, [1]),
    float: (-1.0, np.nan, np.inf, "zz", 1j, True, np.ones(2)),
}
"""What no option of that kind may be."""


@pytest.mark.parametrize("made", [*nd.solvers.SOLVERS.values(), nd.solvers.Nesterov])
def test_options_of_solvers_that_are_none_are_told(made):
    """Each of them when the solver is made: a typo had run as the default, a bad number had failed in a kernel."""
    for option in fields(made):
        kind = float if option.name == "local_tol" else type(option.default)
        for bad in NONE[kind]:
            with pytest.raises(ValueError, match=f"{option.name} must be .*[,;] got {re.escape(repr(bad))}$"):
                made(**{option.name: bad})


@pytest.mark.parametrize(
    ("made", "option", "allowed", "refused"),
    [
        ("PGS", "memory", (0, 1), ()),
        ("PGS", "max_iter", (1,), (0,)),
        ("Auto", "effort", (0.0,), ()),
        ("Auto", "loose", (1e-300,), (0.0,)),
        ("Proximal", "alpha", (1e-3,), (0.0,)),
        ("Proximal", "nu", (0.0,), ()),
        ("GaussSeidel", "local_tol", (None, 1e-3), (0.0,)),
        ("GaussSeidel", "omega", (1e-3, 1.999), (0.0, 2.0)),
        ("ADMM", "relaxation", (1.0, 1.999), (0.999, 2.0)),
        ("Uzawa", "step", (1e-3, 1.999), (0.0, 2.0)),
    ],
)
def test_where_the_options_of_solvers_end(made, option, allowed, refused):
    make = getattr(nd.solvers, made)
    for value in allowed:
        assert getattr(make(**{option: value}), option) == value
    for value in refused:
        with pytest.raises(ValueError, match=f"{option} must be .*, got {value}"):
            make(**{option: value})


def test_options_of_solvers_say_what_was_meant():
    with pytest.raises(ValueError, match=r"did you mean 'natural'\? function must be one of .*; got 'natrual'"):
        nd.solvers.Hybrid(function="natrual")


def test_a_solver_derived_from_another_has_options_of_its_own():
    @dataclass(frozen=True)
    class Counted(nd.solvers.Auto):
        calls: "list[Unknown]" = field(default_factory=list)  # noqa: F821  as of what only type checkers import

    assert Counted(tol=1e-6).calls == []
    with pytest.raises(ValueError, match="tol must be positive and finite, got -1"):
        Counted(tol=-1)


def test_options_say_what_they_may_be():
    @dataclass(frozen=True)
    class Plain(Options):
        tol: float = 1e-8

    with pytest.raises(TypeError, match=r"Plain\.tol must be a Literal or say what is Allowed, got <class 'float'>"):
        Plain()


def test_options_of_solvers_are_numbers_of_python():
    """Those of NumPy had kernels compiled anew, and another text in recordings."""
    assert repr(nd.solvers.PGS(np.float64(1e-8), np.int32(40))) == repr(nd.solvers.PGS(1e-8, 40))


def test_mixture_of_anderson_is_the_least_squares_one(rng):
    """The weights of the past, which sum to one, of the least combined defect, against a dense least-squares solve."""
    F, G, gram, x = rng.normal(size=(4, 9)), rng.normal(size=(4, 9)), np.zeros((4, 4)), np.empty(9)
    for used, slot in ((1, 0), (2, 1), (3, 2), (4, 3), (4, 0)):
        F[slot], G[slot] = rng.normal(size=(2, 9))
        anderson.mix(F, G, gram, slot, used, x)
        others = [j for j in range(used) if j != slot]
        weights = np.linalg.lstsq((F[others] - F[slot]).T, -F[slot], rcond=None)[0]
        # The ridge of 1e-10 of the trace moves weights of order one by no more than that times the condition.
        np.testing.assert_allclose(x, G[slot] + weights @ (G[others] - G[slot]), rtol=0, atol=1e-7)
