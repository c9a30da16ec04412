"""The Moreau–Jean time-stepper: moves between located impacts, and their results.

A step creates a dozen immutable values. They are named tuples, although the rest of the package has frozen dataclasses:
those take three times as long to create, which is a fifth of the step in a small scene.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from nsdyn.collision.contacts import ContactSet
from nsdyn.collision.detector import Detector
from nsdyn.dynamics.dynamics import Dynamics
from nsdyn.dynamics.ledger import Ledger, Works
from nsdyn.problem import gauss, polished
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.solution import Solution, Status
from nsdyn.scene import pairs
from nsdyn.scene.scene import Scene
from nsdyn.solvers import Auto, Solver, as_solver
from nsdyn.stepping import equations
from nsdyn.stepping.contradictions import Prescribed
from nsdyn.stepping.eventless import EventlessSteps
from nsdyn.stepping.failures import Failures, worst
from nsdyn.stepping.flat_state import FlatState
from nsdyn.stepping.functions import Callback, Functions
from nsdyn.stepping.impacts import Law, as_law
from nsdyn.stepping.indeterminacy import Paradoxes
from nsdyn.stepping.initial import begin
from nsdyn.stepping.islands import Islands
from nsdyn.stepping.lazy_step import LazyStep
from nsdyn.stepping.projection import overlaps
from nsdyn.stepping.recorded_step import recorded
from nsdyn.stepping.state import Names, State, Step
from nsdyn.stepping.system import check_options, system_of
from nsdyn.tools import callbacks
from nsdyn.tools.arrays import Array


class Stepper:
    """Moreau–Jean time-stepping of a scene.

    With the free flow Φ (straight lines, torque-free rotation) and h = dt:

        q~, v⁻ = Φ(q_k, v_k, (1 - θ) h)     v⁺ = v⁻ + M̃⁻¹ (h f̃ + H r)     q_{k+1}, v_{k+1} = Φ(q~, v⁺, θ h)
        K* ∋ u + μ‖u_T‖ e_N ⟂ r ∈ K,        u the relative velocity at the end of the step.

    All forces and impulses act at one configuration, so that their works are those of the ledger. Smooth motion is
    second order for θ = ½ without memory of earlier steps, in contact too, and free flight is exact. A step is cut into
    moves at impacts, which act in no time, and where slip stops or reverses, until these are too many to locate. Each
    island (group of bodies that may touch) is cut by itself. Its motion depends on no other body, to the last bit,
    except on the size of the scene's smallest moving body: a fraction of it is the gap tolerance. No shapes overlap at
    the end of a step: a projection of the positions removes remaining penetration. Contacts of free bodies that stay
    closed and stick do no work: a couple per pair of bodies ensures this and keeps every momentum. The ledger has all
    other numerical works.

    Parameters
    ----------
    scene : Scene
    dt : float
        Step h, s.
    theta : float
        In [½, 1]: the impulses act after the fraction 1 - θ of a step. θ > ½ is first order, and damps joint springs,
        `PD` control and stiff trees.
    solver : str or Solver
        A name of `nsdyn.solvers.SOLVERS`, with the tolerance 1e-8, or a solver object. Default and "auto":
        ``Auto(tol=1e-8, loose=1e-4)``.
    controller : callable, optional
        ``controller(t, q, v)`` returns {articulation: `PD`, or joint forces by name or as an array, N m or N, or
        an `Actuation` of the actuators of its file}. It is called twice a step, at the
        time and the configuration q~ where forces and impulses act: first with the velocity v⁻ before them, then with
        the mean velocity ½ (v⁻ + v⁺) of the resulting motion. If its values differ, the second ones act and the motion
        is computed again: laws of the velocity are of second order for θ = ½, as is their work. A step that is cut, at
        impacts or because it is too coarse, calls the function in this way in each move that is tried, at the times of
        the move. q and v have Pinocchio's layout. A function that has a fourth argument `last` is given the last
        `Step`, with its contacts and forces; None before the first.
    external_force : callable, optional
        ``external_force(t, q, v)``, called the same way, returns {free body: force (3,) at its centre of mass, or
        (force, torque)}, world axes, N and N·m; of a robot {"articulation/body": ...}, at the origin of the body's
        frame. Forces do not persist to the next step. Both functions return {} for no force; None is refused.
    on_fail : {"warn", "raise", "dump", "ignore"}
        What to do when the solver misses its tolerance. The status is always recorded. "warn" continues with the best
        solution and warns once. It raises if that solution is unusable: an error above 1e-3, or no velocity that opens
        every contact, which a solution needs. "dump" does the same, and writes the problem of every such step.
    max_points : int
        Most contact points per pair of shapes: the lowest half, and others that span most area. Corners and points of
        rims that the motion shows to be missed do not count.
    dump_on_fail : path, optional
        Folder for the problems of failing steps, with any `on_fail`: FCLIB global files named by the step, with the
        solution found as a guess. "failed-steps" if `on_fail` is "dump".
    impact : {"dissipative", "newton", "poisson", "fremond"} or Law
        Law of impact for contacts with restitution, a name or an object of `nsdyn.stepping.impacts`, which is
        ``nd.impacts``. "dissipative" is Newton's law with the restitution of an island lowered where it would create
        energy. The first time a law creates energy it warns; `Step.created` is the energy created.
    overlap : float
        Deepest initial overlap that is accepted, as a fraction of the inscribed radius of the smaller body; at most 1.
    lift : bool
        Move bodies that overlap at the start apart before the first step, by the projection that follows every step.
        Otherwise the first step does this, its work is in the ledger, and a warning says so.
    polish : bool
        Certify every step through polished solutions (`nsdyn.problem.polished`). The bound is then of the order of the
        error, not of its root, and the defect in Coulomb's law is measured. It costs about as much as the solves.

    Raises
    ------
    ValueError
        For arguments out of range, and for bodies that overlap deeply at the start, naming the bodies and the depth.

    References
    ----------
    J. J. Moreau, Unilateral contact and dry friction in finite freedom dynamics, CISM 302, 1988. M. Jean, The
    non-smooth contact dynamics method, CMAME 177, 1999. V. Acary, Projected event-capturing time-stepping schemes for
    nonsmooth mechanical systems with unilateral contact and Coulomb's friction, CMAME 256, 2013.

    Examples
    --------
    >>> import nsdyn as nd
    >>> stepper = nd.Stepper(nd.scenes.load("slide")(), dt=0.01)
    >>> step = stepper.step()
    >>> step.contact_status.tolist(), round(float(step.v[0]), 5)  # four corners slip: 2 - 0.5 · 9.81 · 0.01 = 1.95095
    ([2, 2, 2, 2], 1.95095)
    """

    def __init__(
        self,
        scene: Scene,
        dt: float = 1e-3,
        theta: float = 0.5,
        solver: str | Solver | None = None,
        controller: Callback | None = None,
        external_force: Callback | None = None,
        on_fail: str = "warn",
        max_points: int = 8,
        dump_on_fail: str | Path | None = None,
        impact: str | Law = "dissipative",
        overlap: float = 0.01,
        lift: bool = False,
        polish: bool = False,
    ) -> None:
        check_options(scene, dt, theta, overlap, lift, polish)
        law = as_law(impact)
        options = theta, solver, controller, external_force, on_fail, max_points, dump_on_fail, impact, overlap, lift
        self._given = (scene, dt, *options, polish)
        self._certificate = polished.certify if polish else gauss.certify
        self.scene, self.dt, self.theta = scene, float(dt), float(theta)
        solver = as_solver(Auto() if isinstance(solver, str | None) and solver in (None, "auto") else solver)
        geoms = scene.geoms()
        self.failures = Failures(on_fail, dump_on_fail, [g.name for g in geoms])
        self.dynamics = Dynamics(scene)
        self.functions = Functions(controller, external_force, self.dynamics)
        # Pairs moved by prescribed motion alone exert no impulses: no velocity could obey the contact law.
        apart = pairs.excluded(scene, geoms) | pairs.among(geoms, self.dynamics.held)
        self.detector = Detector(geoms, pairs.pair_material(scene, geoms), apart, max_points)
        self.system = system_of(scene, geoms, self.dynamics, self.detector, solver, (self.theta, self.dt), law)
        self.gap_tol = self.system.gap_tol
        own = (mu for mu, _ in scene.pairs.values() if mu is not None)
        steepest = max([0.0, *(g.material.mu for g in geoms), *own])
        self._paradoxes = Paradoxes(self.dynamics, solver, steepest)
        off = [f"{a.name}/{one.name}" for a in scene.articulations.values() for one in a.actuators if one.acts]
        if off and controller is None:
            warnings.warn(f"without a controller these actuators are off: {', '.join(off)}", stacklevel=2)
        if not (scene.free_bodies or scene.articulations or scene.driven_bodies):
            warnings.warn("the scene has nothing that moves: all its bodies are fixed, if any", stacklevel=2)
        self._prescribed = None
        if self.dynamics.prescribed:
            self._prescribed = Prescribed(scene, self.dynamics, float(overlap))
        self._islands = Islands(self.system)
        self._eventless: EventlessSteps | None = None
        if (mover := self.system.mover) is not None and not self.functions.take_last:
            loads = partial(self.functions.at, last=None)
            self._eventless = EventlessSteps(self.system, mover, polish, loads, self._paradoxes)
        self._names, self._begin = Names(scene, geoms), partial(begin, self.system, geoms, float(overlap), lift)
        self.reset()

    def __repr__(self) -> str:
        return f"<Stepper of {self.scene.name!r} at t = {self.t:.6g} s, dt = {self.dt:g} s>"

    def __getstate__(self) -> tuple[Any, ...]:
        """What copies are made from: kernels write into arrays of which other parts of a stepper are views."""
        return self._given, self.get_state()

    def __setstate__(self, kept: tuple[Any, ...]) -> None:
        given, state = kept
        Stepper.__init__(self, *given)
        self.set_state(state)

    # -- state -------------------------------------------------------------------------------------------------

    @property
    def t(self) -> float:
        """Time in s."""
        return self._now.t

    @property
    def solver(self) -> Solver:
        """Solver of the contact problems."""
        return self.system.solver

    @property
    def controller(self) -> Callback | None:
        """The controller of the joints."""
        return self.functions["controller"]

    @property
    def external_force(self) -> Callback | None:
        """The function of external forces on the bodies."""
        return self.functions["external_force"]

    def reset(self, q: ArrayLike | None = None, v: ArrayLike | None = None) -> None:
        """Restart at t = 0, from a given state or that of the scene.

        Parameters
        ----------
        q, v : array, shapes (nq,) and (nv,), optional
            Pinocchio's layout, as of `Step.q` and `Step.v`; by default those of the scene. From there loops are closed,
            and joints with prescribed motion get its velocity.

        Raises
        ------
        ValueError
            For wrong shapes, quaternions that are not of norm 1, joints beyond their limits, and deep overlaps, naming
            the cause; the state is then unchanged.
        """
        instant, d = self._begin(q, v), self.dynamics
        energies = d.energies(instant.position, instant.v, instant.energies)
        self._now: State | FlatState = State(0.0, self.dt, 0, instant, np.zeros(d.n), energies)

    def get_state(self) -> State:
        """State after the last step; with `set_state` a run continues bit for bit, warm start included."""
        return self.later()()

    def later(self) -> Callable[[], State]:
        """Return a function that computes the present state when it is called."""
        now = self._now
        return (lambda: now) if isinstance(now, State) else now.state

    def set_state(self, state: State) -> None:
        """Continue from a state of a stepper of the same scene; ValueError if the state does not fit."""
        if not isinstance(state, State):
            raise ValueError(f"state must come from get_state, got {type(state).__name__}")
        v, x = state.instant.v, state.instant.position.x
        if v.shape != (self.dynamics.n,) or x.shape != (self.dynamics.free, 3):
            raise ValueError(f"state must have {self.dynamics.n} velocities like the scene, got {v.shape}")
        i, own, made = state.instant, self.get_state().instant, self.system.detector.made
        if i.sizes != own.sizes or not (made(i.contacts) and made(i.memory)):
            raise ValueError(
                "state must come from a stepper of the same scene; its bodies, joints or shapes are others"
            )
        if state.dt != self.dt:
            state = state._replace(origin=state.t, dt=self.dt, count=0)
        self._now = state

    def start(self) -> Step:
        """The present state as row 0 of a recording: a `Step` with a state and energies only."""
        state, d = self.get_state(), self.dynamics
        s, ledger = state.instant, Ledger.of(state.energies, state.energies, Works())
        q, v = d.pinocchio_state(s.position, s.v)
        x, quaternion = d.poses(s.position, s.placement)
        return Step(t=self.t, q=q, v=v, frames_x=x, frames_quat=quaternion, ledger=ledger)

    def mass_matrix(self) -> Array:
        """M(q) at the present state, shape (nv, nv), kg, kg m and kg m², for v in Pinocchio's layout."""
        return equations.mass_matrix(self.dynamics, self.get_state().instant)

    def bias(self) -> Array:
        """Coriolis, centrifugal and gravity terms at the present state, shape (nv,), N and N m.

        M v̇ + bias = joint forces + Jᵀ contact forces, without joint springs and damping; v in Pinocchio's layout.
        """
        return equations.bias(self.dynamics, self.get_state().instant)

    def contact_jacobian(self) -> tuple[ContactSet, Array, Array]:
        """The contacts at the present state, their frames and the contact Jacobian.

        Returns
        -------
        contacts : ContactSet
            Pairs of shapes near each other, with points, normals and gaps.
        frame : ndarray, shape (nc, 3, 3)
            Rows n, t1, t2 of each, world axes.
        J : ndarray, shape (3 nc, nv)
            u = J v [m/s], (N, T1, T2) of body 2 relative to body 1, v in Pinocchio's layout; without the velocities
            that prescribed motions and moving surfaces add.
        """
        at = self.get_state().instant
        names, points, scalars, next_key = at.contacts
        # Copies, since the next step goes on with these.
        contacts = ContactSet(names.copy(), points.copy(), scalars.copy(), next_key)
        return contacts, *equations.jacobian(self.dynamics, at)

    # -- one step ----------------------------------------------------------------------------------------------

    def step(self) -> Step:
        """Advance by dt and return the step; if it raises, the state is unchanged.

        Raises
        ------
        NotConverged
            According to `on_fail`.
        ValueError
            If the motion leaves the range of numbers, or loops no longer close, naming the step. If the return value of
            a user's function does not fit, naming the file and the line of the function.
        Exception
            Any exception of a user's function.
        """
        try:
            return self._advance()
        except Exception as failure:
            where = f"step {self._now.count + 1} from t = {self.t:.6g} s"
            if (own := callbacks.below(failure)) is not None:
                failure.add_note(f"in {where}")
                failure.__traceback__ = own
            if own is not None or not isinstance(failure, (ValueError, ArithmeticError)):
                raise
            numeric = isinstance(failure, (ArithmeticError, np.linalg.LinAlgError))
            hint = "; look for extreme masses, lengths, speeds or forces" if numeric else ""
            raise ValueError(f"{where} is not possible: {failure}{hint}") from failure

    def _advance(self) -> Step:
        if self._eventless is not None and (step := self._advance_eventless(self._eventless)) is not None:
            return step
        s = self._now = self.get_state()
        begun = None if self._eventless is None else self._eventless.begun(s)
        now, rate, done, *_ = self._islands.step(s, lambda t: self.functions.at(t, s.last), begun)
        sunk = overlaps(self.system, now)
        if self._prescribed is not None:
            depth = self._prescribed.check(s.instant.position, now.position, now.placement, (s.t, s.t + s.dt))
            sunk = sunk or depth > self.gap_tol
        solved = [acted.solved for acted in done]
        k = worst(solved)
        if not solved[k][1].accepted:
            self.failures.tell(*solved[k], done[k].contacts, s, self.solver.tol)
        for acted in done:
            if acted.created > 0.0:
                when = s.t + acted.begin + (1.0 - self.theta) * acted.duration
                self.failures.tell_created(repr(self.system.impact), acted, when)
        certificate, slater = self._certify(solved, s.slater)
        energies = self.dynamics.energies(now.position, now.v, now.energies)
        if not math.isfinite(sum(energies)):
            raise ArithmeticError("positions or velocities are no longer finite")
        self._now = State(s.origin, s.dt, s.count + 1, now, rate, energies, slater)
        problem, solution = solved[k]
        total = Works.total([acted.works for acted in done])
        if self._paradoxes.possible:
            done, total, odd = self._paradoxes.told(done, total, s.dt, rate)
            if odd is not None and solution.converged:
                solution = solution._replace(status=odd)
        ledger = Ledger.of(s.energies, energies, total)
        if solution.accepted and sunk:
            solution = solution._replace(status=Status.OVERLAP)
        problem.kept.clear()  # as large as the problem, and of no use after the step
        certified = {"ledger": ledger, "gauss": certificate, "problem": problem, "solution": solution}
        step = recorded(self.system, self._names, self._now, done, **certified)
        if self.functions.take_last:
            self._now = self._now._replace(last=step)
        return step

    def _advance_eventless(self, kernel: EventlessSteps) -> Step | None:
        """Return an eventless step by the kernel; None if the general step is needed."""
        if (found := kernel.step(self._now, self._certificate)) is None:
            return None
        before, after = found
        if self._prescribed is not None:
            begin, end, times = before.like.position, after.like, (before.t, after.t)
            depth = self._prescribed.check(begin, end.position, end.placement, times)
            if depth > self.gap_tol:
                return None
        untold = LazyStep(after, before, self.system)
        step = Step(untold=untold, t=after.t, dt=after.dt, names=self._names)
        self._now = after
        return step

    def _certify(
        self, solved: list[tuple[FC3D, Solution]], slater: gauss.SlaterDirection | None
    ) -> tuple[gauss.Certificate, gauss.SlaterDirection | None]:
        """Certificate of all problems of a step (sum of duality gaps, largest other values), last Slater direction."""
        if len(solved) == 1:
            problem, solution = solved[0]
            return self._certificate(problem, solution.r, solution.u, slater)
        gap = shift = bound = coulomb = 0.0
        for problem, solution in solved:
            c, slater = self._certificate(problem, solution.r, solution.u, slater)
            gap, shift, bound, coulomb = gap + c.gap, max(shift, c.shift), max(bound, c.bound), max(c.coulomb, coulomb)
        return gauss.Certificate(gap, shift, bound, coulomb), slater
