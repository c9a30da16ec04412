"""The Moreau–Jean time-stepper: one readable step, and the loop around it.

A step makes a dozen immutable values. They are named tuples, where the rest of the package has frozen dataclasses,
which take three times as long to make: in a small scene that is a fifth of the step.
"""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nsdyn import energy, fclib, gauss, impacts
from nsdyn._kernels import encounter as _encounter
from nsdyn.contacts import ContactMemory, ContactSet, Detector
from nsdyn.dynamics import Dynamics, Position
from nsdyn.history import Encounter, History, foresee_slip, release_stopped
from nsdyn.joints import Rows
from nsdyn.problem import FC3D, Array, NotConverged, Solution
from nsdyn.scene import Geom, Scene
from nsdyn.solvers import Auto, Solver
from nsdyn.trajectory import Recorder, Trajectory

__all__ = ["State", "Step", "Stepper", "simulate"]

Callback = Callable[[float, Array, Array], Mapping[str, Any]]

CLOSED = 1e-9
"""Gap, of either sign, that counts as closed, as a fraction of the radius of the smallest moving shape: a length, so
that a scene behaves alike at every scale, and far above round-off, whose jitter would otherwise change the problem of a
body at rest in every step."""

COARSE, MANY = 0.01, 1000
"""Fraction of the deepest penetration that the projection of a pile of that many contacts or more may leave to that of
the next step, so that its effort does not depend on how deep it is."""

DEEPEST = 0.01
"""Initial overlap, as a fraction of the smaller body's radius, beyond which a scene is refused."""


class State(NamedTuple):
    """Everything a run needs to go on bit for bit.

    Attributes
    ----------
    origin, dt, count : float, float, int
        t = origin + count dt.
    position : Position
    v : ndarray, shape (n,)
        Velocity in the coordinates of `Dynamics`.
    history : History
        What the last step leaves to the next.
    memory : ContactMemory
        The last step's contacts and their keys.
    """

    origin: float
    dt: float
    count: int  # type: ignore[assignment]  # tuple.count is of no use here
    position: Position
    v: Array
    history: History
    memory: ContactMemory

    @property
    def t(self) -> float:
        """Time in s."""
        return self.origin + self.count * self.dt

    @property
    def next_t(self) -> float:
        """Time at the end of the next step in s."""
        return self.origin + (self.count + 1) * self.dt


class Step(NamedTuple):
    """What one step did.

    Attributes
    ----------
    t, q, v : float, ndarray, ndarray
        At the end of the step; q and v in Pinocchio's layout.
    frames_x, frames_quat : ndarray of shapes (frames, 3) and (frames, 4), or None
        Poses of all moving frames when the scene has articulations.
    contacts : ContactSet
        Evaluated at the midpoint.
    gap : ndarray, shape (nc,)
        At the end of the step, linear in the motion since the midpoint, m; negative inside.
    frame : ndarray, shape (nc, 3, 3)
        Contact frames, rows (n, t1, t2), world axes.
    u, r : ndarray, shape (nc, 3)
        Relative velocity at the end of the step [m/s] and impulse on body 2 [N·s], normal first.
    contact_status : ndarray of int8, shape (nc,)
        0 open, 1 stick, 2 slip.
    work_normal, work_friction : ndarray, shape (nc,)
        J.
    joint_impulse : ndarray, shape (n,)
        Of joint limits and dry joint friction on each coordinate, N m s or N s.
    created : float
        Energy that the contacts of a step with an impact created, J: 0 but for the paradox of Newton's law (`impacts`).
    ledger : Ledger
        Energies at the end and works of the step, J.
    gauss : Certificate
    problem : FC3D
    solution : Solution
        Of the last problem solved: with Poisson's law r is what its expansion adds.
    times : tuple of 5 floats
        Wall time of broad phase, narrow phase (Coal), manifold and assembly, solve, and the rest, s.
    """

    t: float
    q: Array
    v: Array
    frames_x: Array | None
    frames_quat: Array | None
    contacts: ContactSet
    gap: Array
    frame: Array
    u: Array
    r: Array
    contact_status: NDArray[np.int8]
    work_normal: Array
    work_friction: Array
    joint_impulse: Array
    created: float
    ledger: energy.Ledger
    gauss: gauss.Certificate
    problem: FC3D
    solution: Solution
    times: tuple[float, float, float, float, float]

    @property
    def tangent(self) -> Array:
        """First tangent t1 of every contact, shape (nc, 3); t2 = n × t1."""
        return self.frame[:, 1]

    @property
    def energy(self) -> dict[str, float]:
        """The terms of the ledger by their names, J."""
        return self.ledger._asdict()


class Start(NamedTuple):
    """The initial state as a recording shows it: a `Step` without what steps do."""

    t: float
    q: Array
    v: Array
    frames_x: Array | None
    frames_quat: Array | None
    energy: dict[str, float]


class Stepper:
    """Moreau–Jean θ-scheme on a scene.

    With h = dt and v_{k+θ} = θ v_{k+1} + (1 - θ) v_k:

        M̃ (v_{k+1} - v_k) = h f̃ + H r,   u = Hᵀ v_{k+1} + w,   K* ∋ u + μ‖u_T‖ e_N ⟂ r ∈ K,
        q_{k+1} = q_k ⊕ h v_{k+θ},

    coefficients at q̃ = q_k ⊕ (1 - θ) h v_k; w from the gap or from Newton's impact law, and from the turning of the
    rows of Hᵀ until the end of the step as far as the last steps foretell it (`History`), so that smooth motion is
    second order for θ = ½, in contact too. A free body then keeps its energy and its angular momentum in space to
    round-off, for θ = ½ and up to 2 rad a step. An impact that another one of the same step provokes follows in the
    next. Penetration left by curvature or by a bad start is removed by a projection of the positions that never
    touches v.

    Parameters
    ----------
    scene : Scene
    dt : float
        Step h, s.
    theta : float
        In [½, 1].
    solver : Solver
        Default ``Auto(tol=1e-8)``.
    controller : callable, optional
        ``controller(t, q, v)`` returns {articulation: joint forces (nv,) or `PD`}; called with the time and
        configuration of the midpoint and the velocity at the beginning, Pinocchio's layout.
    external_force : callable, optional
        ``external_force(t, q, v)``, called the same way, returns {free body: force (3,) at its centre of mass, or
        (force, torque)}, world axes, N and N·m; of a robot {"articulation/body": ...}, at the origin of the body's
        frame. Nothing persists to the next step.
    on_fail : {"raise", "warn", "ignore"}
        What to do when the solver misses its tolerance; the status is always recorded.
    max_points : int
        Most contact points per pair of shapes.
    dump_on_fail : path, optional
        Folder for the problems of failing steps, FCLIB global files named by the step, the warm start as a guess.
    impact : {"newton", "poisson", "fremond"}
        Law of contacts with restitution: see `nsdyn.impacts`.

    Raises
    ------
    ValueError
        For arguments out of range, and for bodies that overlap deeply at the start, naming them and the depth.

    References
    ----------
    J. J. Moreau, Unilateral contact and dry friction in finite freedom dynamics, CISM 302, 1988. M. Jean, The
    non-smooth contact dynamics method, CMAME 177, 1999. V. Acary, Projected event-capturing time-stepping schemes for
    nonsmooth mechanical systems with unilateral contact and Coulomb's friction, CMAME 256, 2013.
    """

    def __init__(
        self,
        scene: Scene,
        dt: float = 1e-3,
        theta: float = 0.5,
        solver: Solver | None = None,
        controller: Callback | None = None,
        external_force: Callback | None = None,
        on_fail: str = "raise",
        max_points: int = 8,
        dump_on_fail: str | Path | None = None,
        impact: str = "newton",
    ) -> None:
        if not (isinstance(dt, (int, float)) and math.isfinite(dt) and dt > 0.0):
            raise ValueError(f"dt must be a positive number of seconds, got {dt!r}")
        if not 0.5 <= theta <= 1.0:
            raise ValueError(f"theta must lie in [0.5, 1], got {theta!r}")
        if on_fail not in ("raise", "warn", "ignore"):
            raise ValueError(f"on_fail must be 'raise', 'warn' or 'ignore', got {on_fail!r}")
        for what, given in (("controller", controller), ("external_force", external_force)):
            if given is not None and not callable(given):
                raise ValueError(f"{what} must be a function of (t, q, v) or None, got {given!r}")
        if impact not in impacts.LAWS:
            raise ValueError(f"impact must be one of {impacts.LAWS}, got {impact!r}")
        self.impact = impact
        self.dump_on_fail = None if dump_on_fail is None else Path(dump_on_fail)
        if self.dump_on_fail is not None and self.dump_on_fail.is_file():
            raise ValueError(f"dump_on_fail must be a folder, got the file {dump_on_fail}")
        self.scene, self.dt, self.theta = scene, float(dt), float(theta)
        self.solver: Solver = Auto() if solver is None else solver
        self.controller, self.external_force, self.on_fail = controller, external_force, on_fail
        self.dynamics = Dynamics(scene)
        geoms = scene.geoms()
        self.detector = Detector(geoms, scene.pair_material(geoms), scene.excluded(geoms), max_points)
        # A body slower than this rests: an impact at the speed gravity gives in two steps is a contact force.
        self.resting_speed = 2.0 * self.dt * float(np.linalg.norm(self.dynamics.gravity))
        # Without shapes there are joint limits at most, in rad or in lengths of the order of a metre.
        self.closed = CLOSED * min((g.shape.inscribed_radius for g in geoms if g.frame >= 0), default=0.1)
        # Nor does it pay to remove what the solver's own tolerance lets a contact sink in a step.
        self.closed = max(self.closed, self.solver.tol * self.dt)
        self._law = self.dt, self.theta, self.resting_speed, self.closed
        # What a warm start within the tolerance leaves of the velocities is part of the next impulses that are solved
        # for, which start the step after them as wrong as that. Accepted there, it would stay for ever.
        self._strict = replace(self.solver, accept=0.4) if isinstance(self.solver, Auto) else self.solver
        self._failures = 0
        position, v = self.dynamics.start()
        self._check_overlap(geoms, position)
        history = History.empty(v.size, self.dynamics.joints.size)
        self._state = State(0.0, self.dt, 0, position, v, history, self.detector.memory)

    # -- state -------------------------------------------------------------------------------------------------

    @property
    def t(self) -> float:
        """Time in s."""
        return self._state.t

    def get_state(self) -> State:
        """State after the last step; with `set_state` a run goes on bit for bit, warm start included."""
        return self._state

    def set_state(self, state: State) -> None:
        """Go on from a state of a stepper of the same scene; ValueError if it does not fit."""
        if not isinstance(state, State):
            raise ValueError(f"state must come from get_state, got {type(state).__name__}")
        if state.v.shape != (self.dynamics.n,) or state.position.x.shape != (self.dynamics.free, 3):
            raise ValueError(f"state must have {self.dynamics.n} velocities like the scene, got {state.v.shape}")
        if state.dt != self.dt:
            history = state.history.scaled(self.dt / state.dt)
            state = State(state.t, self.dt, 0, state.position, state.v, history, state.memory)
        self.detector.memory = state.memory
        self._state = state

    def start(self) -> Start:
        """The present state as row 0 of a recording."""
        s, d = self._state, self.dynamics
        kinetic, potential = d.energies(s.position, s.v)
        q, v = d.pinocchio_state(s.position, s.v)
        x, quaternion = d.poses(s.position)
        return Start(s.t, q, v, x, quaternion, {"kinetic": kinetic, "potential": potential})

    # -- one step ----------------------------------------------------------------------------------------------

    def step(self) -> Step:
        """Advance by dt and return what happened; on `NotConverged` the state is left as it was."""
        s, d, h, theta = self._state, self.dynamics, self.dt, self.theta
        clock = time.perf_counter
        t_start = clock()

        # Free motion, with the coefficients of the midpoint.
        begun, ended = d.surfaces.twists(s.t), d.surfaces.twists(s.next_t)
        middle, reach, fast = d.midpoint(s.position, s.v, h, theta, begun, ended)
        callbacks = self._callbacks(middle)
        v_free, loads = d.free_velocity(s.position, middle, s.v, s.next_t, h, theta, s.history.push, *callbacks)

        # Contacts, joint limits and joint friction, and their impact law.
        if fast:  # then contacts are looked for where the step begins, and their gaps extrapolated to the midpoint
            d.place(s.position)
        self.detector.candidates(d.x, d.R, reach)
        t_broad = clock()
        self.detector.narrow()
        t_narrow = clock()
        contacts = self.detector.manifold()
        blocks, frame = d.blocks(contacts)
        joints = d.joint_rows(middle, s.v, v_free, h)
        rows = d.rows(blocks, joints)
        drag, drag_after = d.surfaces.drags(contacts, frame, middle.driven_x, rows.full.nc, begun, ended)
        v = s.v
        if loads.halfway:
            v = s.v.copy()
            for tree, half in zip(d.trees, loads.halfway, strict=True):
                v[tree.coordinates] = half.v
        met = s.history.meet(contacts, joints, rows, frame, (v, v_free), (drag, drag_after), self._law, fast)
        w, struck = met.w, met.struck
        if struck is not None:
            impacts.apply(self.impact, met.u_begin, struck, w)
        q, returned = self._expand(rows, contacts.restitution, met)
        curve = foresee_slip(rows, q, met)
        problem = FC3D.from_blocks(rows.blocks, q + w if curve is None else q + w + curve, met.mu)
        t_assembly = clock()

        # The frictional contact problem.
        solution = (self._strict if s.history.solved else self.solver)(problem, met.guess)
        solved = solution.iterations > 0
        postponed = self._postpone(problem, solution, contacts.restitution, met.u_begin, w) if met.elastic else None
        again, every = postponed is not None, False
        while True:
            impulse = solution.r if returned is None else solution.r + returned
            status, stopped = release_stopped(impulse, contacts.mu, curve, every)
            if not (stopped or again):
                break
            problem = problem.with_velocity(q + w if curve is None else q + w + curve)
            solution = self.solver(problem, solution.r)
            solved, again, every = True, False, True
        t_solve = clock()
        if not solution.converged:
            self._fail(problem, solution, v_free if rows.blocks is rows.full else None, met.guess)

        # Velocities and positions, and what penetration is left in them.
        left = s.history.leave(rows, frame, (v, v_free), drag_after, met, impulse, h, theta)
        v1, gap = left.v, left.gap
        momentum = rows.full.momentum(impulse)
        mean = d.surfaces.mean(begun, ended, theta)
        moved, v_end, ends = d.end(s.position, left.v_theta, h, mean, loads, momentum, v1)
        nc = contacts.gap.size
        end, poses = moved, d.poses(moved)
        d.carry_gaps(contacts, poses, gap)
        if joints is not None:
            gap[nc:] = d.joints.gaps(joints.slot, d.angles(moved))
        if _encounter.smallest(gap) < -self.closed:
            # What rebounds leaves on its own in the next step, if it is not too slow for that, or so fast that it
            # would do so on the other side, or a link of a mechanism in its guide.
            ahead = gap + h * (left.u + theta * (met.u_free - met.u_begin))[0::3]
            leaving = np.zeros(gap.size, np.bool_) if struck is None else struck & (ahead >= 0.0)
            if postponed is not None:
                leaving |= postponed
            leaving &= not fast
            if d.trees:
                leaving[:nc] &= ~d.held(contacts)
            end, gap = self._project(moved, rows, problem, gap, leaving)
            poses = poses if end is moved else d.poses(end)

        # Certificate, ledger, record.
        driving = -0.5 * float((drag + drag_after) @ impulse) if d.surfaces.count else 0.0
        positions, velocities = (s.position, moved, end), (v, v1, left.v_theta)
        ledger = energy.ledger(d, h, theta, loads, positions, velocities, ends, momentum, *left.works, driving)
        created = max(0.0, float((left.normal + left.friction)[:nc].sum())) if struck is not None else 0.0
        r, u = impulse.reshape(-1, 3), left.u.reshape(-1, 3)
        slots, joint_impulse = d.joints.impulses(joints, r[nc:], d.n)
        history = History(
            contacts.key, status, contacts.normal, left.impulse, left.velocity, met.turn, left.change, left.push, slots,
            solved,
        )  # fmt: skip
        self._state = State(s.origin, s.dt, s.count + 1, end, v_end, history, self.detector.memory)
        q_out, v_out = d.pinocchio_state(end, v_end)
        x, quaternion = poses
        certificate = gauss.certify(problem, solution.r, solution.u)
        times = (
            t_broad - t_start, t_narrow - t_broad, t_assembly - t_narrow, t_solve - t_assembly, clock() - t_solve,
        )  # fmt: skip
        return Step(
            self._state.t, q_out, v_out, x, quaternion, contacts, gap[:nc], frame, u[:nc], r[:nc],
            status, left.normal[:nc], left.friction[:nc], joint_impulse, created, ledger, certificate,
            problem, solution, times,
        )  # fmt: skip

    def _expand(self, rows: Rows, restitution: Array, met: Encounter) -> tuple[Array, Array | None]:
        """(relative velocities, impulses) after compression and expansion of Poisson's law; (u_free, None) without."""
        if self.impact != "poisson" or met.struck is None:
            return met.u_free, None
        compression = self.solver(FC3D.from_blocks(rows.blocks, 0.5 * (met.u_begin + met.u_free) + met.w, met.mu))
        r = impacts.returned(compression.r, np.append(restitution, np.zeros(met.mu.size - restitution.size)))
        return met.u_free + rows.blocks.relative_velocity(rows.blocks.velocity_change(r)), r

    def _callbacks(self, middle: Position) -> tuple[Mapping[str, Any] | None, Mapping[str, Any] | None]:
        """(wrenches, joint forces) of the user's callbacks at the midpoint."""
        if self.external_force is None and self.controller is None:
            return None, None
        q, v = self.dynamics.pinocchio_state(middle, self._state.v)
        t = self.t + 0.5 * self.dt
        return (
            self.external_force(t, q, v) if self.external_force else None,
            self.controller(t, q, v) if self.controller else None,
        )

    def _postpone(
        self, problem: FC3D, solution: Solution, restitution: Array, u_begin: Array, w: Array
    ) -> NDArray[np.bool_] | None:
        """Leave impacts that others of this step provoke to the next one, in `w`; tells which of the rows, if any.

        A contact with e > 0 that is open or opening gets no impact law, and what closes it within the step would make
        it perfectly plastic. Where without it the bodies would meet faster than those that rest, w lets them pass.
        """
        late = np.zeros(problem.nc, np.bool_)
        if self.impact != "poisson":  # whose expansion serves them too
            late[: restitution.size] = restitution > 0.0  # joint limits have a law of their own
        if late.any():
            late &= solution.r[0::3] > 0.0
            late &= (w[0::3] > 0.0) | ((w[0::3] == 0.0) & (u_begin[0::3] > self.resting_speed))
        if late.any():
            away = np.zeros_like(w)
            away[0::3][late] = 2.0 * np.abs(problem.q).max()
            free = self.solver(problem.with_velocity(problem.q + away), solution.r)
            late &= (free.u - away - w)[0::3] < -self.resting_speed
            w[0::3][late] += away[0::3][late]
        return late if late.any() else None

    def _fail(self, problem: FC3D, solution: Solution, v_free: Array | None, guess: Array) -> None:
        message = (
            f"step from t = {self.t:.6g} s did not converge: error {solution.error:.2e}, residual "
            f"{solution.residual:.2e} m/s, tolerance {self.solver.tol:.1e} ({solution.status.message})"
        )
        if self.dump_on_fail is not None:
            self.dump_on_fail.mkdir(parents=True, exist_ok=True)
            path = self.dump_on_fail / f"step-{self._state.count + 1:06d}.hdf5"
            fclib.write(path, problem, guesses=[guess], v_free=v_free, description=message, overwrite=True)
            message += f"; its problem is in {path}"
        if self.on_fail == "raise":
            self.detector.memory = self._state.memory
            raise NotConverged(message, problem, solution)
        if self.on_fail == "warn" and not self._failures:
            warnings.warn(message + "; further such steps are recorded without a warning", stacklevel=3)
        self._failures += 1

    def _project(
        self, moved: Position, rows: Rows, problem: FC3D, gap: Array, leaving: NDArray[np.bool_]
    ) -> tuple[Position, Array]:
        """Positions without penetration, the closest in the kinetic metric, and their gaps.

        min ½‖δ‖²_M under g + H_Nᵀ δ ≥ 0: a frictionless contact problem for δ/h, on the gaps g at the end of the
        step, linear in the motion. Contacts that are `leaving` are not pushed. Where nothing penetrates, or nothing
        helps, `moved` itself is returned.
        """
        held = np.where(leaving, np.maximum(gap, 0.0), gap)
        if held.min(initial=0.0) >= -self.closed:
            return moved, gap
        g = np.zeros(3 * gap.size)
        g[0::3] = held / self.dt  # like the velocities of the step, in size and in tolerance
        coarse = -COARSE * float(held.min()) / self.dt if gap.size >= MANY else 0.0
        solver = Auto(tol=self.closed / self.dt, heavy_tol=coarse)
        shift = solver(problem.with_velocity(g, np.zeros(gap.size)))
        lifted = gap + self.dt * (shift.u - g)[0::3]
        # A body squeezed between others has no position without overlap: an answer that does not help may be anything.
        if not shift.converged and np.where(leaving, 0.0, lifted).min() < 0.5 * held.min():
            return moved, gap
        return self.dynamics.advance(moved, rows.velocity_change(shift.r), self.dt), lifted

    def _check_overlap(self, geoms: list[Geom], position: Position) -> None:
        """Refuse scenes whose bodies start deep inside each other, warn of shallow overlaps."""
        d = self.dynamics
        d.place(position)
        contacts = self.detector.detect(d.x, d.R, np.zeros(d.frames))
        if not contacts.gap.size:
            return
        k = int(contacts.gap.argmin())
        a, b = geoms[contacts.geom1[k]], geoms[contacts.geom2[k]]
        depth = -float(contacts.gap[k])
        size = min(g.shape.inscribed_radius for g in (a, b) if g.frame >= 0)
        where = f"{a.name!r} and {b.name!r} overlap at the start by {depth:.3g} m"
        if depth > DEEPEST * size:
            raise ValueError(f"{where}, more than {DEEPEST:.0%} of the smaller one's radius ({size:.3g} m)")
        if depth > 1e-6 * size:  # less is the rounding of a user's own numbers
            warnings.warn(f"{where}; the first step moves them apart", stacklevel=4)


def simulate(
    scene: Scene,
    duration: float,
    dt: float = 1e-3,
    theta: float = 0.5,
    solver: Solver | None = None,
    controller: Callback | None = None,
    external_force: Callback | None = None,
    on_fail: str = "raise",
    record: str | Path | None = None,
    progress: bool = False,
    max_points: int = 8,
    dump_on_fail: str | Path | None = None,
    impact: str = "newton",
) -> Trajectory:
    """Simulate a scene and return its trajectory.

    Parameters
    ----------
    scene : Scene
    duration : float
        s; rounded up to whole steps.
    dt, theta, solver, controller, external_force, on_fail, max_points, dump_on_fail, impact
        As in `Stepper`.
    record : path, optional
        HDF5 file written while the simulation runs; a killed run keeps its steps.
    progress : bool
        Show a progress bar on stderr when it is a terminal.

    Returns
    -------
    Trajectory

    Raises
    ------
    ValueError
        For bad arguments, before anything is written.
    NotConverged
        If a step misses the tolerance and ``on_fail="raise"``; the steps before it are in `record`.
    """
    from tqdm import tqdm  # costs 50 ms that a library user may not need

    if not (isinstance(duration, (int, float)) and math.isfinite(duration) and duration > 0.0):
        raise ValueError(f"duration must be a positive number of seconds, got {duration!r}")
    stepper = Stepper(scene, dt, theta, solver, controller, external_force, on_fail, max_points, dump_on_fail, impact)
    steps = max(1, math.ceil(duration / stepper.dt - 1e-9))
    meta = {"dt": stepper.dt, "theta": stepper.theta, "solver": repr(stepper.solver)}
    with Recorder(record, meta, scene.describe(), stepper.start()) as recorder:
        # disable=None: tqdm draws only on a terminal
        for _ in tqdm(range(steps), unit="step", disable=None if progress else True):
            recorder.append(stepper.step())
        return recorder.trajectory()
