"""Check that kinematic bodies pass through neither each other nor fixed bodies: no impulse could stop them."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pinocchio as pin

from nsdyn._kernels.stepping.options import OPTIONS
from nsdyn.collision.contacts import ContactSet
from nsdyn.collision.detector import Detector
from nsdyn.dynamics.dynamics import Dynamics
from nsdyn.dynamics.trees import Tree
from nsdyn.dynamics.values import Placement, Position
from nsdyn.scene import checks, pairs
from nsdyn.scene.scene import Scene
from nsdyn.tools.arrays import Array
from nsdyn.tools.displacements import integrate

MOST = 1e4
"""Most parts into which a step is divided: with so many, a body of a millimetre is not missed on a way of five
metres."""


Way = tuple[float, Callable[[float, Array, Array], None]]
"""A length, m, and a function that writes the poses of the moved frames after a part of that length into x and R."""

STAYS: Way = 0.0, lambda part, x, R: None


class Prescribed:
    """Bodies, links and joints of a scene that only prescribed motion moves, and the fixed bodies that they may hit.

    The deepest `overlap` that is accepted is a fraction of the inscribed radius of the smaller body, for joint limits a
    fraction of `Options.joint`. ValueError, as in `check`, if the initial poses contradict each other.
    """

    def __init__(self, scene: Scene, dynamics: Dynamics, overlap: float) -> None:
        held, geoms = dynamics.held, scene.geoms()
        chosen = [k for k, g in enumerate(geoms) if g.frame < 0 or held[g.frame]]
        self._geoms = [geoms[k] for k in chosen]
        place = {k: i for i, k in enumerate(chosen)}
        apart = {(place[i], place[j]) for i, j in pairs.excluded(scene, geoms) if i in place and j in place}
        self._detector = Detector(self._geoms, pairs.pair_material(scene, self._geoms), apart)
        self._radius = np.array([g.shape.inscribed_radius if g.frame >= 0 else math.inf for g in self._geoms])
        self._frames = np.unique([g.frame for g in self._geoms if g.frame >= 0]).astype(np.int64)
        self._still, self._dynamics, self._overlap = np.zeros(dynamics.frames), dynamics, overlap
        self._span = [_span(tree) for tree in dynamics.trees]
        start = dynamics.start()[0]
        self.check(start, start, dynamics.place(start), (0.0, 0.0))

    def check(self, begin: Position, end: Position, there: Placement, times: tuple[float, float]) -> float:
        """Return the deepest overlap that prescribed motions leave at the end of a step, m, 0 if none.

        The way from `begin` to `end`, at these times [s], is followed in so many parts that no body passes through
        another unseen; `there` are the placements of the frames at `end`. ValueError if an overlap at the end or on the
        way is deeper than accepted: it names both bodies, the depth and the time.
        """
        self._check_limits(there, times[1])
        if not self._frames.size:
            return 0.0
        ways = [self._of_tree(k, begin.trees[k], end.trees[k], times) for k in range(len(begin.trees))]
        ways.append(self._of_bodies(begin, end, times))
        # Two bodies may move towards each other.
        farthest = 2.0 * max(length for length, _ in ways)
        x, R, parts = there.x.copy(), there.R.copy(), math.ceil(min(farthest / self._radius.min(), MOST))
        for part in range(1, parts):
            for _, place in ways:
                place(part / parts, x, R)
            self._deepest(x, R, times[1])
        return self._deepest(there.x, there.R, times[1])

    def _of_tree(self, k: int, begin: Array, end: Array, times: tuple[float, float]) -> Way:
        """Length of the way of the prescribed links of a tree between two configurations, and their poses on the way.

        Joints turn and shift at constant rates; fast driven joints make additional whole turns.
        """
        tree, h = self._dynamics.trees[k], times[1] - times[0]
        if not tree.held_links.any():
            return STAYS
        step = pin.difference(tree.model, begin, end)
        rates = np.array([0.5 * (motion.rate(times[0]) + motion.rate(times[1])) for motion in tree.driven])
        whole = np.round((h * rates - step[tree.driven_at]) / (2.0 * math.pi))
        step[tree.driven_at] += np.where(tree.turns[tree.driven_at], 2.0 * math.pi * whole, 0.0)
        shifts, moved = ~tree.turns, np.where(tree.held, np.abs(step), 0.0)
        reach = max(np.abs(tree.angle(q)[shifts]).sum() for q in (begin, end)) + self._span[k]

        def place(part: float, x: Array, R: Array) -> None:
            links = tree.links(tree.close(integrate(tree.model, begin, part * step)))
            x[tree.frames], R[tree.frames] = links.x, links.R

        return float(reach * moved[tree.turns].sum() + moved[shifts].sum()), place

    def _of_bodies(self, begin: Position, end: Position, times: tuple[float, float]) -> Way:
        """Length of the way of the kinematic bodies, and their poses on it: straight, with one axis of rotation."""
        surfaces, count = self._dynamics.surfaces, len(begin.driven_x)
        if not count:
            return STAYS
        own, h = slice(-count, None), times[1] - times[0]
        twist = surfaces.mean(surfaces.twists(times[0]), surfaces.twists(times[1]), 0.5)[:count]
        way, turn = end.driven_x - begin.driven_x, h * twist[:, 1]
        R0 = [checks.rotation(q) for q in begin.driven_quaternion]

        def place(part: float, x: Array, R: Array) -> None:
            x[own] = begin.driven_x + part * way
            R[own] = [pin.exp3(part * angle) @ R_body for angle, R_body in zip(turn, R0, strict=True)]

        length = np.linalg.norm(way, axis=1) + self._dynamics.radii[own] * np.linalg.norm(turn, axis=1)
        return float(length.max()), place

    def _check_limits(self, there: Placement, t: float) -> None:
        for tree, links in zip(self._dynamics.trees, there.links, strict=True):
            lower, upper = tree.limits()
            beyond = np.where(tree.held, np.maximum(lower - links.angle, links.angle - upper), -math.inf)
            j = int(beyond.argmax())
            if beyond[j] > self._overlap * OPTIONS.joint:
                joint = tree.joint_of(j)
                raise ValueError(
                    f"prescribed motions contradict: joint '{tree.name}/{joint}' is {beyond[j]:.3g} rad or m beyond "
                    f"its limits, {lower[j]:.6g} and {upper[j]:.6g}, at t = {t:.6g} s"
                )

    def _deepest(self, x: Array, R: Array, t: float) -> float:
        found = self._detector.find(x, R, self._still, ContactSet.empty())
        if not found.gap.size:
            return 0.0
        k = int(found.gap.argmin())
        first, second, depth = int(found.geom1[k]), int(found.geom2[k]), -float(found.gap[k])
        if depth > self._overlap * min(self._radius[first], self._radius[second]):
            a, b = self._geoms[first].name, self._geoms[second].name
            raise ValueError(
                f"prescribed motions contradict: {a!r} and {b!r} overlap by {depth:.3g} m at t = {t:.6g} s"
            )
        return max(depth, 0.0)


def _span(tree: Tree) -> float:
    """Farthest distance of shapes of prescribed links from a joint before them, m, without translations of joints."""
    placements, out = tree.model.jointPlacements, 0.0
    for joint, far in zip(np.array(tree.joints)[tree.held_links].tolist(), tree.radius[tree.held_links], strict=True):
        between = list(tree.model.supports[joint])[2:]  # the world, and the first joint
        out = max(out, far + sum(float(np.linalg.norm(placements[j].translation)) for j in between))
    return out
