"""States of a run, and results of one step, as values."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nsdyn.collision.contacts import ContactSet
from nsdyn.dynamics.ledger import Ledger
from nsdyn.problem import gauss
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.solution import Solution
from nsdyn.scene import checks
from nsdyn.scene.bodies import Geom
from nsdyn.scene.description import describe_links
from nsdyn.scene.scene import Scene
from nsdyn.stepping.impulses import Impulses
from nsdyn.stepping.scene_state import SceneState
from nsdyn.tools.arrays import Array, Bools
from nsdyn.tools.naming import choice, counted

if TYPE_CHECKING:
    from nsdyn.stepping.lazy_step import LazyStep


class State(NamedTuple):
    """All data with which a run continues bit for bit.

    Attributes
    ----------
    origin, dt, count : float, float, int
        t = origin + count dt.
    instant : SceneState
        Position, velocity, contacts and warm start.
    rate : ndarray, shape (nv,)
        Last free acceleration, m/s² and rad/s².
    energies : (float, float)
        Kinetic and potential energy, J.
    slater : gauss.SlaterDirection, optional
        Slater direction of the last certificate.
    last : Step, optional
        The last step, if a callback takes it.
    """

    origin: float
    dt: float
    count: int  # type: ignore[assignment]  # tuple.count is of no use here
    instant: SceneState
    rate: Array
    energies: tuple[float, float]
    slater: gauss.SlaterDirection | None = None
    last: Step | None = None

    @property
    def t(self) -> float:
        """Time in s."""
        return self.origin + self.count * self.dt

    def __repr__(self) -> str:
        return f"<State at t = {self.t:.6g} s, {counted(self.instant.v.size, 'velocity', 'velocities')}>"

    @property
    def next_t(self) -> float:
        """Time at the end of the next step in s."""
        return self.origin + (self.count + 1) * self.dt


class Pieces(NamedTuple):
    """The moves and impacts of a step that was cut, in scenes with articulations, island by island.

    Attributes
    ----------
    begin, duration : ndarray, shape (m,)
        Beginning, s after the beginning of the step, and duration, s, which is 0 for impacts. The impulses of a move
        act after the fraction 1 - theta of its duration.
    contacts : ndarray of int, shape (m,)
        Number of contacts of the step that belong to each move or impact.
    moves : ndarray of int8, shape (m, nv)
        1 for the coordinates of articulations of its island, 0 for all other coordinates.
    joints : ndarray, shape (8, m, nv)
        As in `Step`.
    """

    begin: Array
    duration: Array
    contacts: NDArray[np.int64]
    moves: NDArray[np.int8]
    joints: Array

    @staticmethod
    def of(done: list[Impulses]) -> Pieces:
        """Return the moves and impacts of a step with trees."""
        begin, duration = np.array([(a.begin, a.duration) for a in done]).T
        contacts, every = np.array([a.contacts.gap.size for a in done]), np.ones(done[0].joints.shape[1], np.bool_)
        moves = np.stack([every if a.moves is None else a.moves for a in done]).astype(np.int8)
        return Pieces(begin, duration, contacts, moves, np.stack([a.joints for a in done], axis=1))


class OnBodies(NamedTuple):
    """Nonzero external wrenches on free bodies in the moves of a step, or lifts of free bodies by position projections.

    Attributes
    ----------
    body : ndarray of int, shape (m,)
    time, duration : ndarray, shape (m,)
        Time of the impulses of the move, s after the beginning of the step, and duration of the move, s. A lift is at
        the end of the move, θ times the duration after this time.
    done : ndarray, shape (m, 6)
        World axes. Wrenches: impulse of the force and of its moment about the centre of mass, N·s and N·m·s. Lifts:
        displacement of the centre of mass, m, and rotation vector, rad; they do not change the momenta.
    """

    body: NDArray[np.int64]
    time: Array
    duration: Array
    done: Array

    @staticmethod
    def of(moves: list[tuple[float, float, Array | None]]) -> OnBodies | None:
        """From (time of impulses, duration, values (free, 6) as in `Impulses`) of each move; None without values."""
        some = [(time, h, done, np.flatnonzero(done.any(axis=1))) for time, h, done in moves if done is not None]
        if not some:
            return None
        time, duration = (np.repeat([a[k] for a in some], [a[3].size for a in some]) for k in (0, 1))
        done = np.concatenate([rows[which] for *_, rows, which in some])
        return OnBodies(np.concatenate([which for *_, which in some]), time, duration, done)


class Touch(NamedTuple):
    """The m contacts of two bodies in a step, world axes.

    Attributes
    ----------
    point, normal : ndarray, shape (m, 3)
        m, and from the first body to the second.
    gap : ndarray, shape (m,)
        At the end of the step, m; negative inside.
    velocity : ndarray, shape (m, 3)
        Of the second body relative to the first at the end of the step, m/s.
    force : ndarray, shape (m, 3)
        On the second body, mean over the step, N. For redundant contacts only the sum is unique.
    status : ndarray of int8, shape (m,)
        0 open, 1 stick, 2 slip, 3 jam, as in `Step.contact_status`.
    """

    point: Array
    normal: Array
    gap: Array
    velocity: Array
    force: Array
    status: NDArray[np.int8]


class Names:
    """Names of bodies and articulations of a scene, and the shapes and frames that belong to each."""

    def __init__(self, scene: Scene, geoms: Sequence[Geom]) -> None:
        self._shapes: dict[str, list[int]] = {}
        for k, g in enumerate(geoms):
            for name in dict.fromkeys((g.body, g.link or g.name)):
                self._shapes.setdefault(name, []).append(k)
        self._number = len(geoms)
        self._places = {body.name: (k, np.zeros(3)) for k, body in enumerate(scene.free_bodies)}
        for link in describe_links(scene):
            if link["frame"] >= 0:
                self._places[link["name"]] = link["frame"], np.array(link["placement"])[:3, 3]

    def members(self, name: str) -> Bools:
        """Whether each shape belongs to a body, "articulation/body" or articulation; ValueError for an unknown name."""
        out = np.zeros(self._number, np.bool_)
        out[self._shapes[choice(name, self._shapes, "body")]] = True
        return out

    def place(self, name: str) -> tuple[int, Array]:
        """Frame of a free body or "articulation/body", and its origin there, m; ValueError for an unknown name."""
        return self._places[choice(name, self._places, "moving body")]


class Step:
    """Results of one step.

    A step is immutable. Results of an eventless step are computed at their first access, and then kept.

    Attributes
    ----------
    t, q, v : float, ndarray, ndarray
        Time, s, configuration and velocity at the end of the step; q and v in Pinocchio's layout.
    frames_x, frames_quat : ndarray of shapes (frames, 3) and (frames, 4), or None
        Poses of all moving frames when the scene has articulations.
    contacts : ContactSet
        Contacts at the midpoint, where the impulses acted; those of impacts first.
    gap : ndarray, shape (nc,)
        Gaps of the shapes at the end of the step, m; negative for penetration.
    frame : ndarray, shape (nc, 3, 3)
        Contact frames, rows (n, t1, t2), world axes.
    u, r : ndarray, shape (nc, 3)
        Relative velocity at the end of the step [m/s], or after the impact, and impulse on body 2 [N·s], normal first.
    couple : ndarray, shape (nc, 3)
        Couple on body 2, world axes, N·m·s, with which a persistent contact does no work; 0 for any other contact. It
        is as if the force acted a little off the contact point (`nsdyn.stepping.persistence`).
    contact_status : ndarray of int8, shape (nc,)
        0 open, 1 stick, 2 slip, faster than the solver's tolerance; 3 jam: stopped by an impulse that does not decrease
        with dt although nothing collides. The work of a jam is booked as that of an impact, as normal work.
    contact_time, contact_duration : ndarray, shape (nc,)
        Time of the impulse, s after the beginning of the step, and duration of its move, s: that of the step or of a
        piece of it, 0 for an impact.
    work_normal, work_friction : ndarray, shape (nc,)
        Works, J; the work of the couple is in the normal one.
    joints : ndarray, shape (8, nv), or None
        Per coordinate of the articulations: impulses of actuation, of limits, of dry friction and of external
        wrenches, N m s or N s; displacement by position projections, rad or m; the largest impulse of actuators,
        N m s or N s, infinite without a limit; the change of velocity of prescribed joints, rad/s or m/s, and that by
        impacts captured in a move, 0 for joints that no damping, spring or control of their articulation sees.
        None in scenes without articulations.
    links : ndarray, shape (links, 6)
        Impulses of external wrenches on the links of articulations, one per joint, in the order of joints: force and
        moment about the world's origin, N·s and N m s.
    pieces : Pieces or None
        Moves and impacts of a step that was cut; None for a step of one move, and in scenes without articulations.
    wrenches, lifts : OnBodies or None
        External wrenches on free bodies, and displacements of free bodies by projections; None if there are none.
    created : float
        Energy that impacts created, J, summed over islands of contacts: 0 except for `Newton`'s law with friction or in
        chains, and `Poisson`'s law with several restitutions (`nsdyn.stepping.impacts`).
    ledger : Ledger
        Energies at the end and works of the step, J.
    gauss : Certificate
        Certificate of all problems of the step.
    problem : FC3D
    solution : Solution
        The last contact problem of the step, or the worst if any missed its tolerance. The status is OVERLAP if shapes
        still overlap by more than the gap tolerance, JAM if bodies jam, and SEVERAL if another velocity is found that
        also obeys Coulomb's law (`nsdyn.problem.paradox`).
    twists : two ndarrays of shape (frames, 3)
        Twists of all moving frames at the end of the step: velocities of their origins, m/s, and angular velocities,
        rad/s, world axes.
    dt : float
        Length of the step h, s.
    names : Names
        Names by which `force`, `between` and `velocity` find their bodies.
    untold : LazyStep or None
        Source of the results of an eventless step; None for any other step.
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
    couple: Array
    contact_status: NDArray[np.int8]
    contact_time: Array
    contact_duration: Array
    work_normal: Array
    work_friction: Array
    joints: Array | None
    links: Array
    pieces: Pieces | None
    wrenches: OnBodies | None
    lifts: OnBodies | None
    created: float
    ledger: Ledger
    gauss: gauss.Certificate
    problem: FC3D
    solution: Solution
    twists: tuple[Array, Array]
    dt: float
    names: Names

    untold: LazyStep | None = None

    def __init__(self, **what: Any) -> None:
        self.__dict__.update(what)

    def __getattr__(self, name: str) -> Any:
        if self.untold is not None:
            self.__dict__.update(self.untold.told_with(name))
        if name not in self.__dict__:
            raise AttributeError(f"a step has no {name!r}")
        return self.__dict__[name]

    def __getstate__(self) -> dict[str, Any]:
        for name in self.__annotations__ if self.untold is not None else ():
            getattr(self, name)
        return {**self.__dict__, "untold": None}

    def __setattr__(self, name: str, value: Any) -> None:
        raise AttributeError(f"a step does not change: {name} cannot be set")

    def __repr__(self) -> str:
        if not hasattr(self, "solution"):  # the first row of a recording
            return f"<Step of nothing at t = {self.t:.6g} s>"
        return f"<Step to t = {self.t:.6g} s: {counted(self.gap.size, 'contact')}, {self.solution.status.name}>"

    @property
    def tangent(self) -> Array:
        """First tangent t1 of every contact, shape (nc, 3); t2 = n × t1."""
        return self.frame[..., 1, :]

    @property
    def joint_impulse(self) -> Array:
        """Impulses of joint limits and dry joint friction on each coordinate, shape (nv,), N m s or N s."""
        out = np.zeros(self.v.size)
        if self.joints is not None:
            out[self.v.size - self.joints.shape[1] :] = self.joints[1] + self.joints[2]
        return out

    def force(self, name: str) -> Array:
        """Net contact force on a body, "articulation/body" or articulation, mean over the step, (3,), N, world axes.

        Forces between the links of one articulation cancel. ValueError for an unknown name, naming the known ones.
        """
        on = self.names.members(name)
        sign = 1.0 * on[self.contacts.geom2] - 1.0 * on[self.contacts.geom1]
        return np.einsum("c,ci,cij->j", sign, self.r, self.frame) / self.dt

    def between(self, a: str, b: str) -> Touch:
        """The contacts of two bodies, `a` as the first; names as in `force`. ValueError naming the known ones."""
        on_a, on_b = self.names.members(a), self.names.members(b)
        first, second = self.contacts.geom1, self.contacts.geom2
        sign = 1.0 * (on_a[first] & on_b[second]) - 1.0 * (on_b[first] & on_a[second])
        k = np.flatnonzero(sign)
        push, slip = (sign[k, None] * np.einsum("ci,cij->cj", x[k], self.frame[k]) for x in (self.r, self.u))
        return Touch(
            self.contacts.point[k],
            sign[k, None] * self.frame[k, 0],
            self.gap[k],
            slip,
            push / self.dt,
            self.contact_status[k],
        )

    def velocity(self, name: str) -> tuple[Array, Array]:
        """Velocity of a free body or "articulation/body" at the end of the step: (3,) m/s, (3,) rad/s, world axes.

        The linear velocity is that of the centre of mass, or of the origin of the link's frame. ValueError for an
        unknown name, naming the known ones.
        """
        frame, origin = self.names.place(name)
        linear, angular = (twist[frame].copy() for twist in self.twists)
        if self.frames_quat is not None:
            linear += np.cross(angular, checks.rotation(self.frames_quat[frame]) @ origin)
        return linear, angular

    @property
    def energy(self) -> dict[str, float]:
        """The terms of the ledger by their names, J."""
        return self.ledger._asdict()
