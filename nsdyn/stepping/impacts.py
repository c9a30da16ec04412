"""Laws of impact: how contacts that strike respond, in no time and at one configuration.

U⁻ and U⁺ are the relative velocities before and after, U⁺ = U⁻ + W r. Each contact has a restitution e, which is 0
where the contact rests. On a single frictionless contact all laws agree. Impacts that are provoked by others follow in
rounds: `nsdyn.stepping.rounds`.

To add a law:

1. write a frozen dataclass of its options with the methods of `Law` and a docstring with its equations, its source, and
   when it creates energy; an object of it is an option of `nsdyn.Stepper`;
2. add an entry to `LAWS`: its name is then an option, too;
3. add its line to the docstring of `nsdyn.Stepper` and to `demos/guide/step.md`;
4. `tests/stepping/test_impacts.py` tries all of `LAWS` on single and multiple impacts: state there its promise;
5. `python demos/bench/truth.py impacts` tries to prove that promise wrong.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

from nsdyn.problem.blocks import DelassusFactors
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.solution import Solution
from nsdyn.solvers import Solver
from nsdyn.tools.arrays import Array, Bools, Index, floats
from nsdyn.tools.callbacks import called
from nsdyn.tools.naming import choice

__all__ = ["LAWS", "Dissipative", "Fremond", "Law", "Newton", "Poisson", "Round", "as_law"]

Solved = tuple[FC3D, Solution]
Given = tuple[Array, list[Solved]]


class Round(NamedTuple):
    """One impact in no time, of the contacts that take part.

    Attributes
    ----------
    blocks : DelassusFactors
        Factors of W.
    before : ndarray, shape (3 rows,)
        U⁻, m/s.
    mu, e : ndarray, shape (rows,)
    hit : ndarray of bool, shape (rows,)
        Contacts that approach.
    solver : Solver
    """

    blocks: DelassusFactors
    before: Array
    mu: Array
    e: Array
    hit: Bools
    solver: Solver

    def of(self, part: Bools) -> Round:
        """Return the impact of some of the contacts alone."""
        blocks = self.blocks.of(part)
        return Round(blocks, self.before[np.repeat(part, 3)], self.mu[part], self.e[part], self.hit[part], self.solver)

    def after(self, r: Array) -> Array:
        """Return U⁺ = U⁻ + W r, m/s."""
        return self.before + self.blocks.product(r)

    def solved(self, b: Array) -> Solved:
        """Return the problem K* ∋ y + μ‖y_T‖ e_N ⟂ r ∈ K, y = W r + b, and its solution.

        The solver starts from the impulses without friction, which preserve symmetry: with friction there may be
        several solutions.
        """
        problem, start = FC3D.from_blocks(self.blocks, b, self.mu), None
        if problem.nc > 1 and self.mu.any():
            start = self.solver(FC3D.from_blocks(self.blocks, b, np.zeros(problem.nc)), None).r
        return problem, self.solver(problem, start)

    def islands(self) -> Index:
        """Return the island of each contact, numbered from 0."""
        return self.blocks.islands()

    def work(self, r: Array, label: Index) -> Array:
        """Return the work of impulses on each island, J: ½ (U⁻ + U⁺)·r."""
        work = 0.5 * (self.before + self.after(r)) * r
        return np.bincount(np.repeat(label, 3), work).astype(float, copy=False)

    def created(self, r: Array, label: Index, tol: float) -> Array:
        """Return `work`, but 0 where it is not positive by more than an error `tol` of U, m/s, explains."""
        work = self.work(r, label)
        noise = tol * np.bincount(np.repeat(label, 3), np.abs(r))
        return np.where(work > noise, work, 0.0)


class Law(Protocol):
    """The interface of a law of impact: a frozen dataclass of its own options that is called on an impact."""

    def takes_part(self, hit: Bools, restitution: Array) -> Bools:
        """Mark the closed contacts of a struck island that take part: all, unless a law says otherwise."""
        return np.ones_like(hit)

    def __call__(self, impact: Round) -> Given:
        """Return the impulses r, shape (3 rows,), N·s, and the problems that were solved for them."""


@dataclass(frozen=True)
class Newton:
    """U_N⁺ ≥ -e U_N⁻, friction opposes U_T⁺: K* ∋ y + μ‖y_T‖ e_N ⟂ r ∈ K, y = U⁺ + e U_N⁻ e_N.

    With friction, or in chains of contacts, it may create energy (T. R. Kane, D. A. Levinson, Dynamics: theory and
    applications, 1985); `Step.created` says how much. Resting contacts with restitution follow in a round of their own,
    so that the balls of Newton's cradle strike one after the other.
    """

    def takes_part(self, hit: Bools, restitution: Array) -> Bools:
        """Mark contacts that approach, and contacts that cannot rebound."""
        return hit | (restitution == 0.0)

    def __call__(self, impact: Round) -> Given:
        """Solve one problem."""
        b = impact.before.copy()
        b[0::3] += impact.e * impact.before[0::3]
        solved = impact.solved(b)
        return solved[1].r, [solved]


@dataclass(frozen=True)
class Dissipative(Newton):
    """Newton's law, with the restitution of an island lowered where its impact would otherwise create energy.

    r = (1 - s) r₀ + s r₁, where r₁ is the impulse of `Newton`, r₀ the same with e = 0, and s the largest in [0, 1] for
    which the impulses on the island do no positive work:

        ½ (U⁻ + U⁺)·r ≤ 0,    U_N⁺ = (1 - s) U_N⁰ + s U_N¹ ≥ -s e U_N⁻,    r ∈ K, which is convex.

    Such an s exists: r₀ never does positive work, since ½ (U⁻ + U⁰)·r₀ = -μ‖U_T⁰‖·r₀_N - ½ r₀·W r₀ (J. J. Moreau,
    Unilateral contact and dry friction in finite freedom dynamics, CISM 302, 1988), and the work is a convex quadratic
    of s. So no impact creates energy, whatever W, μ and e. Where Newton's law creates none, the result is that of
    Newton's law, r₁ alone. Where it does, the impact keeps the energy, and friction is a mean of the frictions of r₀
    and r₁. No restitution is left (s = 0) where no velocity obeys Newton's law, as for a body that fits between two
    walls, or where none is found.
    """

    def __call__(self, impact: Round) -> Given:
        """Solve one problem, and one more where the first creates energy."""
        r, solved = super().__call__(impact)
        label = impact.islands()
        created = impact.created(r, label, impact.solver.tol)
        jammed = not solved[0][1].usable
        if not (jammed or created.any()):
            return r, solved
        if jammed and created.size > 1:  # other islands still rebound
            return self._apart(impact, label)
        plastic = impact.solved(impact.before)
        if jammed:
            return plastic[1].r, [plastic]
        share = np.where(created > 0.0, _workless(impact, label, plastic[1].r, r), 1.0)
        return plastic[1].r + np.repeat(share[label], 3) * (r - plastic[1].r), [*solved, plastic]

    def _apart(self, impact: Round, label: Index) -> Given:
        """Solve the islands one by one."""
        r, solved = np.empty_like(impact.before), []
        for k in range(int(label.max()) + 1):
            own = label == k
            r[np.repeat(own, 3)], more = self(impact.of(own))
            solved += more
        return r, solved


def _workless(impact: Round, label: Index, begin: Array, end: Array) -> Array:
    """Return per island the s at which (1 - s) begin + s end does no work; `begin` does none, `end` positive work."""
    # The work is a s² + b s + c; a is the work of the change alone, on bodies at rest.
    a = np.maximum(impact._replace(before=np.zeros_like(begin)).work(end - begin, label), 0.0)
    c = np.minimum(impact.work(begin, label), 0.0)
    b = impact.work(end, label) - a - c
    root = np.sqrt(b * b - 4.0 * a * c)
    with np.errstate(divide="ignore", invalid="ignore"):  # the form with cancellation is not taken
        return np.where(b > 0.0, -2.0 * c / (b + root), (root - b) / (2.0 * a))


@dataclass(frozen=True)
class Poisson(Law):
    """Compression with e = 0 gives r_c; expansion e r_c, and r' where bodies would collide else: r = r_c + e r_c + r'.

    K* ∋ U⁺ + μ‖U_T⁺‖ e_N ⟂ r' ∈ K. It never creates energy if all contacts have one e: the change is at most
    -½ ‖r_e - e r_c‖²_W - ½ (1 - e²) ‖r_c‖²_W with r_e = e r_c + r'. (F. Pfeiffer, C. Glocker, Multibody dynamics with
    unilateral contacts, 1996, chapter 8, with ε_T = ε_N.)
    """

    def __call__(self, impact: Round) -> Given:
        """Solve two problems, one after the other."""
        compression = impact.solved(impact.before)
        r = np.repeat(1.0 + impact.e, 3) * compression[1].r
        expansion = impact.solved(impact.after(r))
        return r + expansion[1].r, [compression, expansion]


@dataclass(frozen=True)
class Fremond(Law):
    """U_N⁺ ≥ -e U_N⁻ where bodies approach, U_N⁺ ≥ -U_N⁻ where they separate, friction opposes ½ (U_T⁺ + U_T⁻).

    No work is ever positive. Every closed contact takes part. Sticking reverses U_T, as on a superball. (M. Frémond,
    Rigid bodies collisions, Physics Letters A 204, 1995.)
    """

    def __call__(self, impact: Round) -> Given:
        """Solve one problem: b_N = (1 + e) U_N⁻ where bodies approach, 2 U_N⁻ where they separate, b_T = 2 U_T⁻."""
        before = impact.before
        b = 2.0 * before
        rebound = before[0::3] + impact.e * before[0::3]
        b[0::3] = np.where(impact.hit, rebound, rebound + np.maximum(before[0::3], 0.0))
        solved = impact.solved(b)
        return solved[1].r, [solved]


LAWS: dict[str, Callable[[], Law]] = {
    "dissipative": Dissipative,
    "newton": Newton,
    "poisson": Poisson,
    "fremond": Fremond,
}
"""Laws by their names."""


def as_law(given: str | Law) -> Law:
    """Return the law of a name of `LAWS`, or the law itself; ValueError for anything else."""
    if isinstance(given, str):
        return LAWS[choice(given, LAWS, "impact")]()
    if isinstance(given, type) or not callable(given) or not hasattr(given, "takes_part"):
        raise ValueError(f"impact must be one of {', '.join(LAWS)}, or an object of these; got {given!r}")
    return given


def takes_part(law: Law, hit: Bools, restitution: Array) -> Bools:
    """Return `Law.takes_part`; ValueError naming a law of the user whose answer does not fit."""
    if type(law) in LAWS.values():
        return law.takes_part(hit, restitution)

    def fit(given: Any) -> Bools:
        part = np.asarray(given)
        if part.dtype != np.bool_ or part.shape != hit.shape:
            raise ValueError(f"takes_part of {type(law).__name__} must return {hit.size} booleans, got {given!r}")
        return part

    return called(law.takes_part, f"takes_part of {type(law).__name__}", fit, hit, restitution)


def answer(law: Law, impact: Round) -> Given:
    """Return the impulses of a law and its problems; ValueError naming a law of the user whose answer does not fit."""
    if type(law) in LAWS.values():
        return law(impact)

    def fit(given: Any) -> Given:
        r, solved = given if isinstance(given, tuple) and len(given) == 2 else (np.nan, None)
        r = floats(r)
        if r.shape != impact.before.shape or not np.isfinite(r).all() or not (isinstance(solved, list) and solved):
            wanted = f"({impact.before.size} finite impulses, a list of the problems solved and their solutions)"
            raise ValueError(f"{type(law).__name__} must return {wanted}, got {given!r}")
        return r, solved

    return called(law, type(law).__name__, fit, impact)
