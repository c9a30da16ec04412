"""States of free bodies as a few arrays, as `nsdyn._kernels.stepping.quiet` takes them, and views of these."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nsdyn._kernels.stepping import quiet as _quiet
from nsdyn.collision.contacts import ContactMemory, ContactSet, Looked
from nsdyn.dynamics.values import Placement
from nsdyn.problem.blocks import Blocks
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.gauss import Certificate, Opening
from nsdyn.problem.solution import Solution, Status
from nsdyn.stepping.encounter import Warm
from nsdyn.stepping.energy import Ledger, Works
from nsdyn.stepping.instant import Instant
from nsdyn.stepping.state import State
from nsdyn.tools.arrays import Array, Index

if TYPE_CHECKING:
    from nsdyn.dynamics.dynamics import Dynamics

__all__ = ["Flat", "Found", "told"]


class Found(NamedTuple):
    """The contacts of a configuration, and rows of W once they are made.

    Attributes
    ----------
    floats : ndarray, shape (61 nc,)
        Points, normals, points in both frames; gaps, mu, restitution; frames; H; scales.
    integers : ndarray of int, shape (9 nc + 2,)
        Both geoms, both frames, keys; blocks, their starts; the size of H and whether rows are made.
    """

    floats: Array
    integers: Index

    @classmethod
    def room(cls, nc: int) -> Found:
        """For so many contacts."""
        return cls(np.empty(_quiet.FOUND * nc), np.empty(_quiet.FOUND_NAMES * nc + 2, np.int64))

    @property
    def nc(self) -> int:
        """Number of contacts."""
        return self.integers.size // _quiet.FOUND_NAMES

    @property
    def names(self) -> Index:
        """As of `ContactMemory`."""
        return self.integers[: 5 * self.nc].reshape(5, -1)

    @property
    def points(self) -> Array:
        """As of `ContactMemory`."""
        return self.floats[: 12 * self.nc].reshape(4, -1, 3)

    @property
    def scalars(self) -> Array:
        """Gaps [m], mu and restitution, shape (3, nc)."""
        return self.floats[12 * self.nc : 15 * self.nc].reshape(3, -1)

    def contacts(self) -> ContactSet:
        """Them as values."""
        names, (point, normal, *_), (gap, mu, restitution) = self.names, self.points, self.scalars
        return ContactSet(names[0], names[1], names[2], names[3], point, normal, gap, mu, restitution, names[4])

    @property
    def frame(self) -> Array:
        """Directions of the contacts, shape (nc, 3, 3)."""
        return self.floats[_quiet.FRAMES * self.nc : _quiet.ROWS * self.nc].reshape(-1, 3, 3)

    @property
    def scales(self) -> Array:
        """λ_max(W_cc), shape (nc,), 1/kg."""
        return self.floats[_quiet.SCALES * self.nc :]

    def blocks(self, d: Dynamics) -> Blocks:
        """Factors of W."""
        nc, i = self.nc, self.integers
        block, start = (i[k * nc : (k + 2) * nc].reshape(-1, 2) for k in (_quiet.BLOCKS, _quiet.STARTS))
        H = self.floats[_quiet.ROWS * nc :][: i[_quiet.SIZE - 2]]
        return d.free_rows(block, start, H).full


class Flat(NamedTuple):
    """A state, and what the step did that led to it.

    Attributes
    ----------
    origin, dt, count : float, float, int
        As of `State`.
    floats : ndarray
        Results, then columns of the bodies and of the contacts that acted.
    acted : ndarray of int, shape (2 nc,)
        Keys of these, and their pairs of shapes.
    status : ndarray of int8, shape (nc,)
    met, found : Found
        Where the impulses acted, and where the step ended.
    next_key : int
    opening : Opening, optional
    like : Instant
        What never changes is that of this one.
    """

    origin: float
    dt: float
    count: int  # type: ignore[assignment]  # tuple.count is of no use here
    floats: Array
    acted: Index
    status: NDArray[np.int8]
    met: Found
    found: Found
    next_key: int
    opening: Opening | None
    like: Instant

    @property
    def t(self) -> float:
        """Time in s."""
        return self.origin + self.count * self.dt

    @property
    def energies(self) -> tuple[float, float]:
        """Kinetic and potential, J."""
        return float(self.floats[_quiet.KINETIC]), float(self.floats[_quiet.POTENTIAL])

    @classmethod
    def of(cls, state: State) -> Flat | None:
        """The same as arrays; None where contacts are remembered that are not there."""
        s, (m, c, w) = state.instant, (state.instant.memory, state.instant.contacts, state.instant.warm)
        nc, n, nw = c.gap.size, s.placement.x.shape[0], w.key.size
        if m.names.shape[1] != nc or not np.array_equal(m.names, [*c[:4], c.key]):
            return None
        if not (np.array_equal(m.points[0], c.point) and np.array_equal(m.points[1], c.normal)):
            return None
        found = Found.room(nc)
        found.names[:], found.points[:], found.scalars[:] = m.names, m.points, (c.gap, c.mu, c.restitution)
        found.integers[-2:] = 0
        floats = np.empty(_quiet.RESULTS + _quiet.BODY * n + _quiet.CONTACT * nw)
        floats[: _quiet.BOUND] = 0.0
        floats[_quiet.KINETIC], floats[_quiet.POTENTIAL] = state.energies
        p, R = s.position, s.placement.R
        columns = p.x, p.quaternion, s.v, R, *s.twists, *s.looked, state.rate, w.force
        at = _quiet.RESULTS
        for column in columns:
            floats[at : at + column.size] = column.ravel()
            at += column.size
        acted = np.concatenate((w.key, w.pair))
        return cls(
            state.origin, state.dt, state.count, floats, acted, w.status, found, found, m.next_key, state.opening, s
        )

    def body(self, first: int, width: int) -> Array:
        """So many columns of the bodies from one on, as one array."""
        n = self.like.placement.x.shape[0]
        begin = _quiet.RESULTS + first * n
        return self.floats[begin : begin + width * n]

    def contact(self, first: int, width: int = 1) -> Array:
        """So many columns of the contacts from one on, as one array."""
        nc, n = self.status.size, self.like.placement.x.shape[0]
        begin = _quiet.RESULTS + _quiet.BODY * n + first * nc
        return self.floats[begin : begin + width * nc]

    def instant(self) -> Instant:
        """Its end."""
        x, quaternion = self.body(_quiet.X, 3).reshape(-1, 3), self.body(_quiet.QUATERNION, 4).reshape(-1, 4)
        R = self.body(_quiet.R, 9).reshape(-1, 3, 3)
        looked = (
            self.body(_quiet.LOOKED, 3).reshape(-1, 3),
            self.body(_quiet.LOOKED + 3, 9).reshape(-1, 3, 3),
            self.body(_quiet.LOOKED + 12, 1),
        )
        nc, like = self.status.size, self.like
        force = self.contact(_quiet.FORCE, 3).reshape(-1, 3)
        return Instant(
            like.position.moved(x, quaternion),
            self.body(_quiet.V, 6),
            Placement(x, R, ()),
            self.found.contacts(),
            like.limits,
            ContactMemory(self.found.names, self.found.points, self.next_key),
            Looked(*looked),
            Warm(self.acted[:nc], self.acted[nc:], force, self.status, like.warm.joints, None),
            self.twists,
            (),
        )

    @property
    def twists(self) -> tuple[Array, Array]:
        """Velocities of the bodies, m/s and rad/s, (n, 3) each, world axes."""
        return self.body(_quiet.LINEAR, 3).reshape(-1, 3), self.body(_quiet.ANGULAR, 3).reshape(-1, 3)

    def problem(self, d: Dynamics) -> FC3D:
        """The problem of the step."""
        b, norm = self.contact(_quiet.FREE, 3), float(self.floats[_quiet.NORM])
        return FC3D.prepared(self.met.blocks(d), b, self.met.scalars[1], self.met.scales, norm)

    def solution(self, tol: float) -> Solution:
        """Its solution, to a solver's tolerance or accepted all the same."""
        error, residual, count, time = self.floats[_quiet.ERROR : _quiet.CERTIFIED].tolist()
        r, u = self.contact(_quiet.IMPULSE, 3), self.contact(_quiet.U, 3)
        status = Status.CONVERGED if max(error, residual) <= tol else Status.LOOSE
        return Solution(r, u, status, error, residual, int(count), time)

    def works(self) -> Works:
        """Of the step, J."""
        external, normal, friction, numerics = self.floats[_quiet.EXTERNAL : _quiet.NORM].tolist()
        return Works(external, normal, friction, 0.0, 0.0, numerics, 0.0)

    def state(self) -> State:
        """The state as the general step takes it."""
        rate = self.body(_quiet.RATE, 6)
        return State(self.origin, self.dt, self.count, self.instant(), rate, self.energies, self.opening)


def told(flat: Flat, before: tuple[float, float], scheme: tuple[float, float], d: Dynamics) -> dict[str, Any]:
    """What a quiet step did, by the names of `Step`.

    Parameters
    ----------
    flat : Flat
        Where it ended.
    before : (float, float)
        Energies where it began, J.
    scheme : (float, float)
        θ and the solver's tolerance.
    d : Dynamics
    """
    f, nc, n, met = flat.floats, flat.status.size, flat.like.placement.x.shape[0], flat.met
    bodies = f[_quiet.RESULTS : _quiet.RESULTS + _quiet.BODY * n]
    of = f[_quiet.RESULTS + _quiet.BODY * n :].reshape(_quiet.CONTACT, nc)
    x, quaternion = bodies[: 3 * n].reshape(n, 3), bodies[3 * n : 7 * n].reshape(n, 4)
    q, v = d.pinocchio_state(flat.like.position.moved(x, quaternion), bodies[_quiet.V * n : _quiet.R * n])
    time = np.empty(nc)
    time.fill((1.0 - scheme[0]) * flat.dt)
    return {
        "q": q,
        "v": v,
        "frames_x": None,
        "frames_quat": None,
        "contacts": met.contacts(),
        "gap": of[_quiet.GAP_END],
        "frame": met.frame,
        "u": of[_quiet.U_END : _quiet.NORMAL_WORK].reshape(nc, 3),
        "r": of[_quiet.IMPULSE : _quiet.U].reshape(nc, 3),
        "couple": np.zeros((nc, 3)),
        "contact_status": flat.status,
        "contact_time": time,
        "work_normal": of[_quiet.NORMAL_WORK],
        "work_friction": of[_quiet.FRICTION_WORK],
        "joints": None,
        "links": d.no_push,
        "pieces": None,
        "created": 0.0,
        "ledger": Ledger.of(before, flat.energies, flat.works()),
        "gauss": Certificate(*f[_quiet.GAP : _quiet.WENT].tolist()),
        "problem": flat.problem(d),
        "solution": flat.solution(scheme[1]),
        "twists": flat.twists,
    }
