"""What a recording holds, as arrays over its steps: energies, certificates, solves, motions, and contacts of a step."""

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
from nsdyn.tools.arrays import Array
from nsdyn.tools.naming import counted
from nsdyn.tools.table import Table

__all__ = ["BodyMotion", "ContactTable", "Energy", "Gauss", "SolverLog", "rotate"]


@dataclass(frozen=True, eq=False)
class Energy:
    """Energies and works in J: kinetic + potential grows in each step by the sum of the works and the defect.

    Attributes
    ----------
    kinetic, potential : ndarray, shape (n + 1,)
        At the times t.
    external, normal, friction, damping, constraint : ndarray, shape (n,)
        Physics, work done on the system in each step: by applied forces and joint actuation, by the normal and the
        tangential impulses of contacts and joints, by viscous joint damping, by prescribed motion and closed loops.
    integration, projection : ndarray, shape (n,)
        Numerics: by the time discretisation of smooth motion, by position projection and what takes back such gains.
    defect : ndarray, shape (n,)
        What the ledger of each step fails to explain; round-off when all is well.
    created : ndarray, shape (n,)
        What of `normal` and `friction` the contacts of a step with an impact created, by a paradox of its law; no
        term of the balance. NaN in recordings that do not tell.
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
        """The terms of the balance, states first."""
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
        Size of the perturbation of the step that was solved exactly, m/s.
    bound : ndarray
        At least the error of the velocity in the kinetic norm, √J; infinite where none is (`nsdyn.problem.gauss`).
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
    """What the solver reported in each step, shape (n,).

    Attributes
    ----------
    error, residual : ndarray
        `FC3D.error` [-] and `FC3D.residual` [m/s].
    iterations : ndarray of int
    status : ndarray of int8
        Values of `nsdyn.problem.fc3d.Status`; 0 is converged.
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
        """Names of the status of each step."""
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
        m. Of the centre of mass of a free body, of the frame of a link or a joint.
    quaternion : ndarray, shape (n + 1, 4)
        xyzw, body to world.
    """

    name: str
    position: Array
    quaternion: Array
    _velocity: Callable[[], tuple[Array, Array]]

    def __repr__(self) -> str:
        return f"<BodyMotion of {self.name!r}: {counted(len(self.position), 'state')}>"

    @cached_property
    def _velocities(self) -> tuple[Array, Array]:
        return self._velocity()

    @property
    def linear_velocity(self) -> Array:
        """Velocity of `position`, shape (n + 1, 3), m/s.

        That of a driven body is the slope of its recorded positions, to second order in the time between them; so are
        links in recordings before format 7, which do not tell their joints.
        """
        return self._velocities[0]

    @property
    def angular_velocity(self) -> Array:
        """Angular velocity, shape (n + 1, 3), rad/s; found as `linear_velocity`."""
        return self._velocities[1]


def rotate(quaternion: Array, vector: Array) -> Array:
    """R(quaternion) vector, xyzw in the last axis."""
    axis, w = quaternion[..., :3], quaternion[..., 3:]
    turn = 2.0 * np.cross(axis, vector)
    out: Array = vector + w * turn + np.cross(axis, turn)
    return out


@dataclass(frozen=True, eq=False)
class ContactTable:
    """Contacts of one step, nc rows; SI units, world frame.

    Attributes
    ----------
    body1, body2 : tuple of str
        Names of the bodies, "articulation/body" of a link.
    shape1, shape2 : tuple of str
        Names of their shapes; a free body has one, of its own name.
    point, normal, tangent : ndarray, shape (nc, 3)
        Normal from body 1 to body 2; t1, with t2 = n x t1.
    gap : ndarray, shape (nc,)
        At the end of the step, m, positive apart.
    u : ndarray, shape (nc, 3)
        Velocity of body 2 relative to body 1 after the step, (N, T1, T2), m/s.
    impulse : ndarray, shape (nc, 3)
        On body 2, its opposite on body 1, (N, T1, T2), N·s. Of redundant contacts of two bodies those of least norm
        that obey the law of contact with the same force and torque: see `nsdyn.recording.shares`.
    impulse_raw : ndarray, shape (nc, 3)
        The same as the solver found them, not unique when contacts are redundant.
    unique : ndarray of bool, shape (nc,)
        Whether the impulse of the contact is the only one that gives this motion, by rank
        (`nsdyn.recording.uniqueness`). It is found when it is asked for.
    couple : ndarray, shape (nc, 3)
        On body 2, world axes, its opposite on body 1, N·m·s, with which contacts that persist do no work; NaN in
        recordings before format 8.
    mu, restitution : ndarray, shape (nc,)
    key : ndarray of int64, shape (nc,)
        The same for the same features of the same pair of shapes in the next step.
    status : ndarray of int8, shape (nc,)
        0 open, 1 stick, 2 slip, faster than the solver's tolerance, 3 jam (`nsdyn.Step.contact_status`).
    time, duration : ndarray, shape (nc,)
        When the impulse acted, s after the beginning of the step, NaN in recordings before format 6; and how long the
        move was that it acted in, s, 0 of an impact in no time, NaN before format 10.
    work_normal, work_friction : ndarray, shape (nc,)
        Of the solver's impulses, J; their sum over two bodies is that of any impulses with the same force and torque.
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
    _unique: Callable[[], NDArray[np.bool_]]

    @cached_property
    def unique(self) -> NDArray[np.bool_]:
        """Whether the impulse of the contact is the only one that gives this motion, shape (nc,)."""
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
        out: Array = r[:, :1] * self.normal + r[:, 1:2] * self.tangent + r[:, 2:] * other
        return out

    @property
    def status_names(self) -> list[str]:
        """Words for the status of each contact: open, stick, slip or jam."""
        return [CONTACT_STATES[s] for s in self.status]

    def __len__(self) -> int:
        return self.gap.size

    def __repr__(self) -> str:
        return repr(self._table())

    def _repr_html_(self) -> str:
        return self._table()._repr_html_()

    def _table(self) -> Table:
        """What is shown of it."""
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
