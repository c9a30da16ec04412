"""Motion of an articulation in each recorded step, recomputed from the state at its beginning and recorded impulses.

A step, or each of its pieces (substeps), is a motion without forces for the fraction 1 - θ, then all impulses at one
configuration, then a motion without forces for the rest. The recorded impulses are used unchanged. With the length h of
the piece, mass matrix M, gravity terms g, damping D, springs K stretched by s, and B of loops and driven joints,

    M (v⁺ - v⁻) = impulses - h g - h D (θ v⁺ + (1 - θ) v°) - h K (s + h θ² v⁺ - h (1 - θ)² v°) + Bᵀ λ,    B v⁺ = b,

where v° is v⁻ after the impacts that a move captures before its forces.

If only gravity and constant joint forces act on a tree, they may also act throughout the piece.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from nsdyn.recording.columns import ON_JOINTS
from nsdyn.recording.courses import Course, move, respond
from nsdyn.recording.mechanism import Mechanism
from nsdyn.recording.tables import contact_steps, impulses_world
from nsdyn.tools.arrays import Array, Index
from nsdyn.tools.displacements import displacement

if TYPE_CHECKING:
    from nsdyn.recording.trajectory import Trajectory

Piece = tuple[float, list[tuple[int, int, int]], Array]
"""(duration, contacts, impulses on the joints) of a piece of a step, that is a move or an impact."""


class Contradiction(str):
    """Reason why the described articulations cannot be those whose motion was recorded."""


class Kick(NamedTuple):
    """Impulses and forces of a piece, all at one configuration.

    Attributes
    ----------
    h : float
        Length of the piece, s; 0 for impacts in no time.
    q, before, struck, after : ndarray
        Configuration, and velocities: before, after captured impacts, as far as forces see them, and after.
    given : ndarray, shape (4, nv)
        Impulses of actuation, limits, dry friction and external wrenches.
    shift : ndarray, shape (nv,)
        Displacement by the position projection at the end of the piece.
    pushed : ndarray, shape (nv,)
        Generalised impulses of contacts.
    touches : list of (row, side, joint)
        Contacts on links; side 0 or 1 of the contact is on the link of the joint.
    stiff : ndarray, shape (2, nv)
        Impulses of damping and springs.
    reaction : ndarray, shape (nv,)
        Bᵀ λ of loops and driven joints.
    rate : ndarray, shape (nv,)
        Acceleration without contacts, limits and dry friction; 0 for impacts in no time.
    mean : ndarray, shape (nv,), or None
        Mean velocity if the forces act throughout the piece.
    """

    h: float
    q: Array
    before: Array
    struck: Array
    after: Array
    given: Array
    shift: Array
    pushed: Array
    touches: list[tuple[int, int, int]]
    stiff: Array
    reaction: Array
    rate: Array
    mean: Array | None = None


class Way(NamedTuple):
    """Recomputed motion of one tree in one step.

    Attributes
    ----------
    kicks : list of Kick
    flows : list of Course
        Free motions before and after each kick.
    q, v : ndarray
        Configuration and velocity at the end.
    """

    kicks: list[Kick]
    flows: list[Course]
    q: Array
    v: Array


@dataclass(frozen=True, eq=False)
class Trees:
    """The articulations of a recording.

    Attributes
    ----------
    trajectory : Trajectory
    mechanisms : tuple of Mechanism
    at : tuple of (slice, slice)
        Coordinates of each mechanism in q and v.
    rows : tuple of slice
        Its coordinates in the columns of `/joints` and `/pieces`.
    links : dict of int to (int, int)
        Tree and joint of the moving frames of links.
    """

    trajectory: Trajectory
    mechanisms: tuple[Mechanism, ...]
    at: tuple[tuple[slice, slice], ...]
    rows: tuple[slice, ...]
    links: dict[int, tuple[int, int]]

    @cached_property
    def impulses(self) -> Array:
        """Impulses of all contacts on body 2, world axes, N·s."""
        return impulses_world(self.trajectory.columns)

    @cached_property
    def touches(self) -> list[dict[int, list[tuple[int, int, int]]]]:
        """For every tree, by step from 0 on: (row, side, joint) of its contacts, in ascending order."""
        t, out = self.trajectory, [dict[int, list[tuple[int, int, int]]]() for _ in self.mechanisms]
        frames = np.array([geom["frame"] for geom in t.scene["geoms"]], dtype=np.int64)
        step = contact_steps(t) - 1
        sides = (
            np.stack([frames[t.columns[f"contacts/geom{k}"]] for k in "12"], axis=1)
            if frames.size
            else np.empty((0, 2))
        )
        for row, side in zip(*np.nonzero(np.isin(sides, list(self.links))), strict=True):
            tree, joint = self.links[int(sides[row, side])]
            out[tree].setdefault(int(step[row]), []).append((int(row), int(side), joint))
        return out

    def state(self, tree: int, k: int | Index) -> tuple[Array, Array]:
        """Return q and v of a tree in row k of the states, or in several rows."""
        q, v = self.at[tree]
        return self.trajectory.q[k, q], self.trajectory.v[k, v]

    def pieces(self, tree: int, k: int) -> Iterator[Piece]:
        """Yield the pieces of step k, from 0 on, in which a tree moves."""
        c, rows, touches = self.trajectory.columns, self.rows[tree], self.touches[tree].get(k, [])
        cut = range(*c["pieces/offset"][k : k + 2])
        if not cut:
            yield self.trajectory.dt, touches, np.array([c[f"joints/{name}"][k, rows] for name in ON_JOINTS])
        first = int(c["contacts/offset"][k])
        for p in cut:
            last = first + int(c["pieces/contacts"][p])
            if not c["pieces/moves"][p, rows].any():  # of another island
                first = last
                continue
            own = [touch for touch in touches if first <= touch[0] < last]
            yield float(c["pieces/duration"][p]), own, np.array([c[f"pieces/{name}"][p, rows] for name in ON_JOINTS])
            first = last

    def way(self, tree: int, k: int) -> Way:
        """Recompute the motion of a tree in step k, from 0 on.

        Joint forces that act alone act throughout a piece, unless they come from a law that the step treats implicitly.
        The recording does not contain which. Of the two motions the one is returned whose end is closer to the recorded
        state, after subtraction of its doubt.
        """
        m, (q, v) = self.mechanisms[tree], self.state(tree, k + 1)
        out, pieces = [], list(self.pieces(tree, k))
        for all_along in (True, False):
            out.append(self._way(tree, k, pieces, all_along))
            if not (self.trajectory.meta["controller"] and any(k.mean is not None for k in out[0].kicks)):
                break

        def off(way: Way) -> tuple[float, float]:
            scale, doubted = [[self.trajectory.dt], [1.0]], sum(course.doubted for course in way.flows)
            far = np.abs([displacement(m.model, way.q, q), way.v - v])
            return np.max((far - doubted) / scale, initial=0.0), np.max(far / scale, initial=0.0)

        return min(out, key=off)

    def _way(self, tree: int, k: int, pieces: list[Piece], all_along: bool) -> Way:
        """Recompute the motion; `all_along` lets forces that act alone act throughout their piece."""
        m, theta, (q, v) = self.mechanisms[tree], float(self.trajectory.meta["theta"]), self.state(tree, k)
        kicks, flows, told = list[Kick](), list[Course](), [m.speeds[int(j)] for j in m.driven]
        for piece in pieces:
            h, _, given = piece
            first = move(m, q, v, (1.0 - theta) * h)
            speeds = v[m.driven] + given[6, m.driven]
            speeds = np.array([x if rate is None else rate for x, rate in zip(speeds, told, strict=True)])
            kick = self._kick(m, first, piece, theta, speeds)
            pushed = kick.pushed.any() or given[1:3].any() or m.loops or m.damping.any() or m.stiffness.any()
            if all_along and h and not pushed:
                last = move(m, q, v, h, (given[0] + given[3]) / h, (speeds - v[m.driven]) / h)
                kick, first = kick._replace(mean=last.mean), last._replace(doubted=0.0 * last.doubted, work=0.0)
            else:
                last = move(m, kick.q, kick.after, theta * h)
            kicks.append(kick)
            flows += [first, last]
            q, v = m.lifted(last.q, last.v, kick.shift)
        return Way(kicks, flows, q, v)

    def _kick(self, m: Mechanism, at: Course, piece: Piece, theta: float, speeds: Array) -> Kick:
        """Apply the impulses of a piece, and its forces, at a configuration."""
        (h, touches, given), c, pushed = piece, self.trajectory.columns, np.zeros(m.nv)
        m.place(at.q)
        for row, side, joint in touches:
            pushed += m.push(joint, c["contacts/point"][row], (2 * side - 1) * self.impulses[row])
        M, v, bend, struck = m.mass(at.q), at.v, m.stretch(at.q), at.v + given[7]
        begin = (1.0 - theta) * np.diag(m.damping) - h * (1.0 - theta) ** 2 * np.diag(m.stiffness)
        end = theta * np.diag(m.damping) + h * theta**2 * np.diag(m.stiffness)
        known = given[:4].sum(axis=0) + pushed - h * m.weight(at.q)
        momentum = M @ v + known - h * (begin @ struck + m.stiffness * bend)
        B = m.constraints(at.q)[1] if m.bound else np.empty((0, m.nv))
        # Forces remove the velocity error of loops that the free motion leaves; an impact in no time keeps this error.
        goal = np.zeros(len(B)) if h else B @ v
        goal[len(B) - speeds.size :] = speeds

        def left_by(momentum: Array) -> Array:
            if m.bound:
                return respond(M + h * end, momentum, B, goal)
            return np.asarray(np.linalg.solve(M + h * end, momentum), dtype=float)

        after = left_by(momentum)
        reaction = (M + h * end) @ after - momentum if m.bound else np.zeros(m.nv)
        rate = (left_by(momentum - given[1] - given[2] - pushed) - v) / h if h else np.zeros(m.nv)
        damping = -h * m.damping * (theta * after + (1.0 - theta) * struck)
        springs = -h * m.stiffness * (bend + h * (theta**2 * after - (1.0 - theta) ** 2 * struck))
        stiff = np.array([damping, springs])
        return Kick(h, at.q, v, struck, after, given[:4], given[4], pushed, touches, stiff, reaction, rate)


def _grown(told: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield the description of each tree of an articulation as if it were alone; loops or gears join trees into one."""
    model, first = told["model"], np.cumsum([0, *(nv for _, nv in told["sizes"])])
    roots = [k for k, joint in enumerate(model["joints"]) if joint["parent"] == 0]
    joined = [[k - 1 for k in loop["joints"] if k] for loop in model["loops"]]
    joined += [
        [int(np.searchsorted(first, gear[f"coordinate{side}"], side="right")) - 1 for side in (1, 2)]
        for gear in model["gears"]
    ]
    starts = [k for k in roots if not any(min(both, default=k) < k <= max(both, default=-1) for both in joined)]
    for begin, end in pairwise([*starts, len(model["joints"])]):
        low, high = int(first[begin]), int(first[end])
        part = dict(model)
        part["joints"] = [joint | {"parent": max(0, joint["parent"] - begin)} for joint in model["joints"][begin:end]]
        for law in ("armature", "friction", "damping", "stiffness", "rest", "effort", "lower", "upper"):
            part[law] = model[law][low:high]
        names = told["joints"][begin:end]
        part["driven"] = {name: rate for name, rate in model["driven"].items() if name in names}
        part["loops"] = [
            loop | {"joints": [max(0, k - begin) for k in loop["joints"]]}
            for loop in model["loops"]
            if begin < max(loop["joints"]) <= end
        ]
        part["gears"] = [
            gear | {f"coordinate{side}": gear[f"coordinate{side}"] - low for side in (1, 2)}
            for gear in model["gears"]
            if low <= gear["coordinate2"] < high
        ]
        yield {"name": told["name"], "joints": names, "sizes": told["sizes"][begin:end], "model": part}


def trees(trajectory: Trajectory) -> Trees | str:
    """Return the articulations of a recording, or the reason why they cannot be built."""
    scene = trajectory.scene
    q, v, row, at, rows = 7 * scene["free"], 6 * scene["free"], 0, [], []
    mechanisms: list[Mechanism] = []
    places: dict[str, tuple[int, int]] = {}
    for articulation in scene["articulations"]:
        for told in _grown(articulation):
            try:
                m = Mechanism(told["name"], told["joints"], told["model"], scene["gravity"])
            except KeyError as failure:
                return f"{told['name']!r} cannot be built: {failure.args[0]} is no kind of joint that is known"
            except ValueError as failure:
                return Contradiction(f"{told['name']!r} cannot be built: {failure}")
            nq, nv = np.sum(told["sizes"], axis=0)
            if (m.model.nq, m.nv) != (nq, nv):
                return Contradiction(f"{told['name']!r} cannot be built: it has {m.model.nq} and {m.nv} coordinates")
            places |= {f"{told['name']}/{joint}": (len(mechanisms), i) for i, joint in enumerate(told["joints"], 1)}
            mechanisms.append(m)
            at.append((slice(q, q + nq), slice(v, v + nv)))
            rows.append(slice(row, row + nv))
            q, v, row = q + nq, v + nv, row + nv
    frames: list[Any] = scene["frames"]
    links = {k: places[name] for k, name in enumerate(frames) if k >= scene["free"] and name in places}
    return Trees(trajectory, tuple(mechanisms), tuple(at), tuple(rows), links)
