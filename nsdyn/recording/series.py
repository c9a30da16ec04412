"""Contents of a recording as arrays over its steps: energies, certificates, solves, motions, contacts of a step."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from nsdyn.dynamics.ledger import WORKS
from nsdyn.recording import shares
from nsdyn.recording.columns import CONTACT_STATES, ENERGIES
from nsdyn.tools.arrays import Array, Bools, cross
from nsdyn.tools.naming import counted
from nsdyn.tools.table import Table


@dataclass(frozen=True, eq=False)
class Energy:
    """Energies and works in J: kinetic + potential grows in each step by the sum of the works and the defect.

    Attributes
    ----------
    kinetic, potential : ndarray, shape (n + 1,)
        At the times t.
    external, normal, friction, damping, constraint : ndarray, shape (n,)
        Physics, work done on the system in each step: by applied forces and joint actuation, by the normal impulses of
        impacts, by friction of contacts and joints, by viscous joint damping, by prescribed motion and closed loops.
    integration, projection : ndarray, shape (n,)
        Numerics: work of the time discretisation of smooth motion, and of the position projection.
    defect : ndarray, shape (n,)
        Remainder of the ledger of each step; round-off when all is well.
    created : ndarray, shape (n,)
        The part of `normal` and `friction` that a law of impact created in the step, against physics (Kane's paradox).
        It is not a term of the balance.
    """

    kinetic: Array
    potential: Array
    external: Array
    normal: Array
    friction: Array
    damping: Array
    constraint: Array
    integration: Array
    projection: Array
    defect: Array
    created: Array

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the terms of the balance: energies, then works."""
        return ENERGIES + WORKS

    @property
    def total(self) -> Array:
        """Kinetic + potential, shape (n + 1,)."""
        return self.kinetic + self.potential

    def __repr__(self) -> str:
        works = ", ".join(f"{name} {getattr(self, name).sum():.4g}" for name in WORKS if getattr(self, name).any())
        total, steps = self.total, counted(self.defect.size, "step")
        return f"<Energy over {steps}: from {total[0]:.6g} to {total[-1]:.6g} J; works {works or 'none'}>"


@dataclass(frozen=True, eq=False)
class Gauss:
    """Certificate of each step by Gauss's principle, shape (n,).

    Attributes
    ----------
    gap : ndarray
        Duality gap, J.
    shift : ndarray
        Size of the perturbation of the step's problem that the solution solves exactly, m/s.
    bound : ndarray
        Upper bound of the velocity error in the kinetic norm, √J; infinite where no bound exists
        (`nsdyn.problem.gauss`).
    coulomb : ndarray
        Defect in Coulomb's law, √J (`nsdyn.problem.polished`); NaN unless the steps were certified with `polish`.
    """

    gap: Array
    shift: Array
    bound: Array
    coulomb: Array

    def __repr__(self) -> str:
        bound, shift = self.bound.max(initial=0.0), self.shift.max(initial=0.0)
        return f"<Gauss of {counted(self.gap.size, 'step')}: bound up to {bound:.2e} √J, shift up to {shift:.2e} m/s>"


@dataclass(frozen=True, eq=False)
class SolverLog:
    """Report of the solver in each step, shape (n,).

    Attributes
    ----------
    error, residual : ndarray
        `FC3D.error` [-] and `FC3D.residual` [m/s].
    iterations : ndarray of int
    status : ndarray of int8
        Values of `nsdyn.Status`; 0 is converged.
    time : ndarray
        Wall time of the solve, s.
    """

    error: Array
    residual: Array
    iterations: NDArray[np.int32]
    status: NDArray[np.int8]
    time: Array

    @property
    def status_names(self) -> list[str]:
        """Name of the status of each step."""
        from nsdyn.problem.solution import Status

        return [Status(int(s)).name for s in self.status]

    def __repr__(self) -> str:
        count = ", ".join(f"{n} {name}" for name, n in Counter(self.status_names).most_common())
        worst, most = self.residual.max(initial=0.0), self.iterations.max(initial=0)
        return (
            f"<SolverLog of {counted(self.time.size, 'step')}: {count}, residual up to {worst:.2e} m/s, "
            f"iterations up to {most}>"
        )


@dataclass(frozen=True, eq=False)
class BodyMotion:
    """Motion of one body or link in the world frame.

    Attributes
    ----------
    name : str
    position : ndarray, shape (n + 1, 3)
        Centre of mass of a free body, origin of the frame of a link or a joint, m.
    quaternion : ndarray, shape (n + 1, 4)
        xyzw, body to world.
    """

    name: str
    position: Array
    quaternion: Array
    _velocity: Callable[[], tuple[Array, ...]]

    def __repr__(self) -> str:
        return f"<BodyMotion of {self.name!r}: {counted(len(self.position), 'state')}>"

    @cached_property
    def _velocities(self) -> tuple[Array, ...]:
        return self._velocity()

    @property
    def linear_velocity(self) -> Array:
        """Velocity of `position`, shape (n + 1, 3), m/s.

        For a driven body it is the slope of the recorded positions, of second order in the time between them.
        """
        return self._velocities[0]

    @property
    def angular_velocity(self) -> Array:
        """Angular velocity, shape (n + 1, 3), rad/s; computed like `linear_velocity`."""
        return self._velocities[1]


def rotate(quaternion: Array, vector: Array) -> Array:
    """Return the vector rotated by the quaternion, xyzw in the last axis."""
    axis, w = quaternion[..., :3], quaternion[..., 3:]
    turn = 2.0 * cross(axis, vector)
    return vector + w * turn + cross(axis, turn)


@dataclass(frozen=True, eq=False)
class ContactTable:
    """Contacts of one step, nc rows; SI units, world frame.

    Attributes
    ----------
    body1, body2 : tuple of str
        Names of the bodies, "articulation/body" for a link.
    shape1, shape2 : tuple of str
        Names of their shapes; a free body has one shape, with the name of the body.
    point, normal, tangent : ndarray, shape (nc, 3)
        Contact point, m; normal from body 1 to body 2; tangent t1, with t2 = n x t1.
    gap : ndarray, shape (nc,)
        Gap at the end of the step, m, positive apart.
    u : ndarray, shape (nc, 3)
        Velocity of body 2 relative to body 1 after the step, (N, T1, T2), m/s.
    impulse : ndarray, shape (nc, 3)
        Impulse on body 2, (N, T1, T2), N·s; body 1 receives the opposite. For redundant contacts of two bodies, the
        impulses of least norm with the same force and torque that obey the contact law: see `nsdyn.recording.shares`.
    impulse_raw : ndarray, shape (nc, 3)
        Impulses as the solver returned them, not unique when contacts are redundant.
    unique : ndarray of bool, shape (nc,)
        Whether only one impulse of the contact gives this motion, by rank (`nsdyn.recording.uniqueness`). Computed on
        first access.
    couple : ndarray, shape (nc, 3)
        Couple on body 2, world axes, N·m·s, with which persistent contacts do no work; body 1 receives the opposite.
    mu, restitution : ndarray, shape (nc,)
    key : ndarray of int64, shape (nc,)
        Key that identifies the same features of the same pair of shapes in the next step.
    status : ndarray of int8, shape (nc,)
        0 open, 1 stick, 2 slip, faster than the solver's tolerance, 3 jam (`nsdyn.Step.contact_status`).
    time, duration : ndarray, shape (nc,)
        Time at which the impulse acted, s after the beginning of the step; and duration of the move in which it acted,
        s, 0 for an impact in no time.
    work_normal, work_friction : ndarray, shape (nc,)
        Works of the solver's impulses, J. The sum over the contacts of two bodies is the same for all impulses with the
        same force and torque.
    """

    body1: tuple[str, ...]
    body2: tuple[str, ...]
    shape1: tuple[str, ...]
    shape2: tuple[str, ...]
    point: Array
    normal: Array
    tangent: Array
    gap: Array
    u: Array
    impulse_raw: Array
    couple: Array
    mu: Array
    restitution: Array
    key: NDArray[np.int64]
    status: NDArray[np.int8]
    time: Array
    duration: Array
    work_normal: Array
    work_friction: Array
    _unique: Callable[[], Bools]

    @cached_property
    def unique(self) -> Bools:
        """Whether only one impulse of the contact gives this motion, shape (nc,)."""
        return self._unique()

    @cached_property
    def impulse(self) -> Array:
        """Impulse on body 2, shape (nc, 3), (N, T1, T2), N·s."""
        bodies = np.unique([self.body1, self.body2], return_inverse=True)[1].reshape(2, -1).T
        columns = {name: getattr(self, name) for name in shares.COLUMNS if name != "impulse"}
        return shares.shared(bodies, np.zeros(len(self), np.int64), columns | {"impulse": self.impulse_raw})

    @property
    def impulse_world(self) -> Array:
        """Impulse on body 2 in the world frame, shape (nc, 3), N·s."""
        other = np.cross(self.normal, self.tangent)
        r = self.impulse
        return r[:, :1] * self.normal + r[:, 1:2] * self.tangent + r[:, 2:] * other

    @property
    def status_names(self) -> list[str]:
        """Name of the status of each contact: open, stick, slip or jam."""
        return [CONTACT_STATES[s] for s in self.status]

    def __len__(self) -> int:
        return self.gap.size

    def __repr__(self) -> str:
        return repr(self._table())

    def _repr_html_(self) -> str:
        return self._table()._repr_html_()

    def _table(self) -> Table:
        """Return the columns that are printed."""
        u, r = self.u, self.impulse
        columns = {
            "body1": np.array(self.body1, dtype=object),
            "body2": np.array(self.body2, dtype=object),
            "gap": self.gap,
            "u_N": u[:, 0],
            "u_T": np.hypot(u[:, 1], u[:, 2]),
            "r_N": r[:, 0],
            "r_T": np.hypot(r[:, 1], r[:, 2]),
            "mu": self.mu,
            "status": np.array(self.status_names, dtype=object),
        }
        return Table("contacts", columns, {"gap": "m", "u_N": "m/s", "u_T": "m/s", "r_N": "N·s", "r_T": "N·s"})
