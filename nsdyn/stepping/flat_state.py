"""States as a few arrays, the layout of `nsdyn._kernels.stepping.eventless`, and the values they contain."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nsdyn._kernels.compiled import plain
from nsdyn._kernels.stepping import columns as _col
from nsdyn.collision.contacts import ContactSet, DetectionPose
from nsdyn.dynamics.values import Energies, Placement, Position
from nsdyn.problem.blocks import DelassusFactors
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.gauss import SlaterDirection
from nsdyn.problem.solution import Solution, Status
from nsdyn.stepping.scene_state import SceneState, WarmStart
from nsdyn.stepping.state import State
from nsdyn.tools.arrays import Array, Index

if TYPE_CHECKING:
    from nsdyn.dynamics.dynamics import Dynamics
    from nsdyn.stepping.tree_motion import TreeMotion

VIEWS = "column", "vectors", "rotations", "velocity", "placed", "contacts", "rows", "answer", "local"
column, vectors, matrices, velocity, placed, contacts, rows, answer, local = (
    plain(_col.__name__)[name] for name in VIEWS
)
"""Views of columns, made by the same functions as plain Python: a call of a kernel takes longer."""

Acted = tuple[Array, Index, NDArray[np.int8]]
"""State in the kernel's layout: floats; keys, then pairs of shapes, of the contacts that acted last; their states."""


class Found(NamedTuple):
    """The contacts detected at a configuration, and the factors of W once they are computed.

    Attributes
    ----------
    floats : ndarray
        Points, normals, points in both frames; gaps, mu, restitution; contact frames; scales; H.
    integers : ndarray of int, shape (9 nc + 2,)
        Both geoms, both frames, keys; blocks, their starts; the size of H and whether H is computed.
    next_key : int
        As in `ContactSet`.
    """

    floats: Array
    integers: Index
    next_key: int

    def of(self, nc: int) -> Found:
        """The same, cut to `nc` contacts; the arrays had memory for more."""
        return Found(self.floats, self.integers[: _col.FOUND_NAMES * nc + 2], self.next_key)

    def anew(self) -> Found:
        """A copy whose factors of W are to be computed anew."""
        integers = self.integers.copy()
        integers[_col.MADE - 2] = 0
        return Found(self.floats.copy(), integers, self.next_key)

    @property
    def nc(self) -> int:
        """Number of contacts."""
        return self.integers.size // _col.FOUND_NAMES

    def contacts(self) -> ContactSet:
        """The contacts as a `ContactSet`."""
        names, points, scalars = contacts(self[:2], self.nc)
        return ContactSet(names, points, scalars, self.next_key)

    @property
    def frame(self) -> Array:
        """Directions of the contacts, shape (nc, 3, 3)."""
        return matrices(self.floats, _col.FRAMES, self.nc)

    @property
    def scales(self) -> Array:
        """λ_max(W_cc), shape (nc,), 1/kg."""
        return column(self.floats, _col.SCALES, self.nc)

    def blocks(self, d: Dynamics, masses: tuple[Array, Array]) -> DelassusFactors:
        """Factors of W, with M and its inverse."""
        _, block, start, H, _, made = rows(self[:2], self.nc)
        return DelassusFactors(d.offset, block, start, H[: made[_col.SIZE]], d.m_start, *masses)


class FlatState(NamedTuple):
    """A state, and the results of the step that led to it.

    Attributes
    ----------
    origin, dt, count : float, float, int
        As in `State`.
    floats : ndarray
        Results, then columns of the bodies and of the contacts of the active set.
    acted : ndarray of int, shape (2 nc,)
        Keys of the contacts of the active set, then their pairs of shapes.
    status : ndarray of int8, shape (nc,)
    active, found : Found
        The active set at the midpoint, and the contacts found at the end of the step.
    slater : SlaterDirection, optional
    like : SceneState
        Supplies all fields that have no column. With trees the next motion also begins there.
    motion : TreeMotion, optional
        Motion of the trees in the step.
    """

    origin: float
    dt: float
    count: int  # type: ignore[assignment]  # tuple.count is of no use here
    floats: Array
    acted: Index
    status: NDArray[np.int8]
    active: Found
    found: Found
    slater: SlaterDirection | None
    like: SceneState
    motion: TreeMotion | None

    @property
    def size(self) -> tuple[int, int]:
        """Frames and coordinates."""
        return self.like.placement.x.shape[0], self.like.v.size

    @property
    def t(self) -> float:
        """Time in s."""
        return self.origin + self.count * self.dt

    @property
    def of_trees(self) -> Energies:
        """Energies of the trees, J."""
        return self.like.energies if self.motion is None else self.motion.energies

    @property
    def energies(self) -> tuple[float, float]:
        """Kinetic and potential energy, J."""
        kinetic, potential = self.floats[_col.KINETIC : _col.EXTERNAL].tolist()
        for more in () if self.motion is None else self.motion.energies:
            kinetic, potential = kinetic + more[0], potential + more[1]
        return kinetic, potential

    @classmethod
    def of(cls, state: State, wide: int) -> FlatState | None:
        """Return a state as arrays, `wide` numbers of H per contact; None if its memory differs from its contacts."""
        s = state.instant
        if (given := packed(s, state.rate, wide)) is None:
            return None
        (floats, acted, status), found = given
        floats[: _col.BOUND] = 0.0
        floats[_col.KINETIC], floats[_col.POTENTIAL] = state.energies
        own = floats, acted, status, found, found, state.slater, s, None
        return cls(state.origin, state.dt, state.count, *own)

    def frame(self, first: int, width: int) -> Array:
        """`width` columns of the frames, from column `first` on, (frames, width)."""
        n, _ = self.size
        begin = _col.RESULTS + first * n
        return self.floats[begin : begin + width * n].reshape(n, width)

    def coordinate(self, which: tuple[int, int]) -> Array:
        """The column `which` of the coordinates, (n,)."""
        return velocity(self.floats[_col.RESULTS :], which, self.size)

    def contact(self, first: int, width: int = 1) -> Array:
        """`width` columns of the contacts, from column `first` on, as one array."""
        nc, (n, nv) = self.status.size, self.size
        begin = _col.RESULTS + _col.FRAME * n + _col.COORDINATE * nv + first * nc
        return self.floats[begin : begin + width * nc]

    def instant(self) -> SceneState:
        """The state at the end of the step as a `SceneState`."""
        nc, found = self.status.size, self.found.contacts()
        force = self.contact(_col.FORCE, 3).reshape(-1, 3)
        return self.begin()._replace(
            position=self.position,
            placement=self.place._replace(links=self.like.placement.links),
            contacts=found,
            memory=found,
            warm=WarmStart(self.acted[:nc], self.acted[nc:], force, self.status, self.like.warm.joints),
            twists=self.twists,
            energies=self.of_trees,
        )

    def begin(self) -> SceneState:
        """The state where the next motion begins, without new contacts, their warm start and energies."""
        like = self.like
        if like.position.trees:  # the last motion of trees stored it
            return like
        found, v = (like.contacts, like.limits, like.memory), self.coordinate(_col.V)
        where = detected_at(self.floats[_col.RESULTS :], _col.DETECTED_AT, self.size[0])
        return SceneState(self.position, v, self.place, *found, where, like.warm, like.twists, ())

    @property
    def position(self) -> Position:
        """Positions of all bodies."""
        free = self.like.position.x.shape[0]
        return self.like.position.moved(self.frame(_col.X, 3)[:free], self.frame(_col.QUATERNION, 4)[:free])

    @property
    def twists(self) -> tuple[Array, Array]:
        """Velocities of the frames, m/s and rad/s, (frames, 3) each, world axes."""
        return self.frame(_col.LINEAR, 3), self.frame(_col.ANGULAR, 3)

    @property
    def place(self) -> Placement:
        """Placements of the frames, without links."""
        return Placement(self.frame(_col.X, 3), self.frame(_col.R, 9).reshape(-1, 3, 3), ())

    def solved(self, d: Dynamics, tol: float) -> tuple[FC3D, Solution]:
        """The contact problem of the step and its solution, by the function `solved`."""
        masses = d.masses[3:]
        if self.motion is not None:
            masses = self.motion.mid.forces.m, self.motion.mid.forces.minv
        return solved(self.floats, self.contact(0, _col.CONTACT), self.active, self.active.blocks(d, masses), tol)

    def state(self) -> State:
        """The state in the form of the general step."""
        rate = self.coordinate(_col.RATE)
        return State(self.origin, self.dt, self.count, self.instant(), rate, self.energies, self.slater)


def packed(s: SceneState, rate: Array, wide: int) -> tuple[Acted, Found] | None:
    """Return a state and its contacts in the kernel's layout; its results and factors of W are not set.

    H has `wide` numbers per contact. None if the remembered contacts are not those of the state.
    """
    m, c, w = s.memory, s.contacts, s.warm
    nc, p, acted = c.gap.size, s.position, np.concatenate((w.key, w.pair))
    if m is not c and not (np.array_equal(m.names, c.names) and np.array_equal(m.points, c.points)):
        return None
    floats = [c.points.ravel(), c.scalars.ravel(), np.empty((_col.ROWS - _col.FRAMES + wide) * nc)]
    integers = np.concatenate((c.names.ravel(), np.zeros(4 * nc + 2, np.int64)))
    found = Found(np.concatenate(floats), integers, m.next_key)
    turns = np.concatenate((p.quaternion, np.zeros((s.placement.x.shape[0] - p.x.shape[0], 4))))
    columns = s.placement.x, turns, s.placement.R, *s.twists, *s.detected_at, s.v, rate, w.force
    room = np.empty(_col.RESULTS), *[column.ravel() for column in columns]
    more = np.empty((_col.CONTACT - _col.IMPULSE) * w.key.size)
    return (np.concatenate((*room, more)), acted, w.status), found


def solved(floats: Array, acted: Array, active: Found, blocks: DelassusFactors, tol: float) -> tuple[FC3D, Solution]:
    """Return the problem of the active set and its solution, from the results and contact columns of a state.

    The status is `CONVERGED` within the solver's tolerance `tol`, else `LOOSE`.
    """
    r, u, b = answer(acted, active.nc)
    problem = FC3D.prepared(blocks, b, active.contacts().mu, active.scales, float(floats[_col.NORM]))
    error, residual, count, time = floats[_col.ERROR : _col.CERTIFIED].tolist()
    status = Status.CONVERGED if max(error, residual) <= tol else Status.LOOSE
    return problem, Solution(r, u, status, error, residual, int(count), time)


def put(f: Array, k: int, n: int, values: Array) -> None:
    """Write values into the columns from k on, starting at the first frame."""
    f[k * n : k * n + values.size] = values.ravel()


def detected_at(f: Array, k: int, n: int) -> DetectionPose:
    """Poses and reaches at which contacts are detected, stored in the columns from k on."""
    return DetectionPose(*placed(f, k, n))
