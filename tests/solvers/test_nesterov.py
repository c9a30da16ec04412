"""Sweeps with momentum, and the piles that `auto` gives to them."""

import numba
import numpy as np
import pytest

import nsdyn as nd
from nsdyn._kernels import simd
from nsdyn._kernels.problem import unit_mass
from nsdyn.problem.solution import Status
from nsdyn.solvers import nesterov


def settling(steps: int = 60) -> nd.FC3D:
    """A step's problem of 64 spheres that have just fallen into a box."""
    scene, material = nd.Scene(), nd.Material(mu=0.5)
    scene.add_halfspace("ground", material=material)
    for k, normal in enumerate([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0)]):
        scene.add_halfspace(f"wall{k}", normal=normal, offset=-0.37, material=material)
    rng = np.random.default_rng(0)
    for k in range(64):
        cell = np.array([k % 4 - 1.5, k // 4 % 4 - 1.5, k // 16 + 0.6]) * 0.18
        cell[:2] += rng.uniform(-0.005, 0.005, 2)
        scene.add_sphere(f"ball{k}", 0.08, 1.0, position=cell, material=material)
    stepper = nd.Stepper(scene, dt=5e-3, solver=nd.solvers.Auto(tol=1e-4))
    for _ in range(steps):
        problem = stepper.step().problem
    return problem


@pytest.fixture(scope="module")
def pile() -> nd.FC3D:
    return settling()


def test_solves_a_pile_from_nothing(pile: nd.FC3D) -> None:
    solution = nd.solvers.Nesterov(tol=1e-6)(pile)
    assert solution.converged
    assert pile.nc > 80
    exact = nd.solve(pile, tol=1e-10)
    # Velocities are unique where the friction is moderate: a hundred times the tolerance is what a pile amplifies.
    assert np.abs(solution.u - exact.u).max() < 1e-4


def test_it_beats_plain_sweeps(pile: nd.FC3D) -> None:
    plain = nd.solvers.PGS(tol=1e-6, memory=0)(pile)
    assert nd.solvers.Nesterov(tol=1e-6)(pile).iterations < 0.5 * plain.iterations


def test_a_guess_that_solves_costs_nothing(pile: nd.FC3D) -> None:
    r = nd.solvers.Nesterov(tol=1e-6)(pile).r
    again = nd.solvers.Nesterov(tol=1e-6)(pile, r)
    assert again.iterations == 0
    assert np.array_equal(again.r, r)


def test_gives_up_without_gain(pile: nd.FC3D) -> None:
    solution = nd.solvers.Nesterov(tol=1e-17, patience=500)(pile)
    assert solution.status is Status.STALLED


def test_frictionless_contacts_have_one_row(pile: nd.FC3D) -> None:
    assert pile.blocks is not None
    mu = np.where(np.arange(pile.nc) % 2, 0.0, pile.mu)
    problem = nd.FC3D.from_blocks(pile.blocks, pile.q, mu)
    guess = np.ones(3 * pile.nc)  # with friction that such contacts do not have
    solution = nd.solvers.Nesterov(tol=1e-6)(problem, guess)
    assert solution.converged
    assert not solution.r.reshape(-1, 3)[mu == 0.0, 1:].any()
    assert np.abs(solution.u - nd.solve(problem, tol=1e-10).u).max() < 1e-4  # as above


def test_sweeps_on_a_given_matrix_are_those_on_factors(pile: nd.FC3D) -> None:
    """The same method where W is given instead of its factors."""
    r, x = np.zeros_like(pile.q), np.zeros_like(pile.q)
    free, given = nesterov.Sweeps(pile, r), nesterov.Sweeps(nd.FC3D(pile.W, pile.q, pile.mu), x)
    assert given.best == pytest.approx(free.best, rel=1e-12)
    for sweeps in (free, given):
        sweeps.run(1e-6, 3000, 3000)
        assert sweeps.best <= 1e-6
    assert np.abs(pile.velocity(r) - pile.velocity(x)).max() < 1e-4  # as above


def test_rows_in_vector_instructions(rng: np.random.Generator) -> None:
    """Compiled, the products of rows are those that the functions are in Python."""

    @numba.njit
    def compiled(a: np.ndarray, b: np.ndarray) -> float:
        one, two, six = np.uint64(16), np.uint64(0), np.uint64(24)
        total = simd.dot(a, one, b, two, six)
        simd.add((0.5, -1.0, 2.0), a, two, b, one, six)
        simd.add((3.0,), a, six, b, two, one)
        return total

    a, b = rng.normal(size=(2, 48))
    x, y = b.copy(), b.copy()
    assert compiled(a, x) == compiled.py_func(a, y)
    np.testing.assert_array_equal(x, y)


def test_order_of_independent_contacts(pile: nd.FC3D) -> None:
    """Every body keeps the order of its contacts, and most neighbours share none."""
    blocks = pile.blocks
    assert blocks is not None
    order = unit_mass.independent(blocks.arrays)
    assert sorted(order) == list(range(blocks.nc))
    for body in range(blocks.n // 6):
        own = [c for c in order if body in blocks.block[c]]
        assert own == sorted(own)
    pairs = [set(blocks.block[c][blocks.block[c] >= 0]) for c in order]
    shared = sum(bool(a & b) for a, b in zip(pairs[1:], pairs[:-1], strict=True))
    assert shared < 0.2 * blocks.nc
