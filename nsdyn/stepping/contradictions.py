"""What moves as prescribed must not go through what is there: nothing gives way, so that no impulse can stop it."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from nsdyn.collision.contacts import ContactMemory
from nsdyn.collision.detector import Detector
from nsdyn.dynamics.dynamics import Dynamics
from nsdyn.dynamics.values import Placement
from nsdyn.scene import pairs
from nsdyn.scene.scene import Scene
from nsdyn.stepping.instant import JOINT
from nsdyn.tools.arrays import Array

__all__ = ["Prescribed"]

MOST = 1e4
"""Parts of a step, which a body of a millimetre passes in on five metres."""


class Prescribed:
    """Bodies, links and joints of a scene that nothing but prescribed motion moves, and what they may run into.

    Parameters
    ----------
    scene : Scene
    dynamics : Dynamics
    arm : ndarray, shape (frames,)
        How far shapes reach from the origins of their frames, m.
    overlap : float
        Deepest overlap that is taken, as a fraction of the inscribed radius of the smaller body; of joint limits as one
        of `JOINT`.

    Raises
    ------
    ValueError
        Where they contradict each other from the start, as `check`.
    """

    def __init__(self, scene: Scene, dynamics: Dynamics, arm: Array, overlap: float) -> None:
        held, geoms = dynamics.held, scene.geoms()
        chosen = [k for k, g in enumerate(geoms) if g.frame < 0 or held[g.frame]]
        self._geoms = [geoms[k] for k in chosen]
        place = {k: i for i, k in enumerate(chosen)}
        apart = {(place[i], place[j]) for i, j in pairs.excluded(scene, geoms) if i in place and j in place}
        self._detector = Detector(self._geoms, pairs.pair_material(scene, self._geoms), apart)
        self._radius = np.array([g.shape.inscribed_radius if g.frame >= 0 else math.inf for g in self._geoms])
        self._frames = np.unique([g.frame for g in self._geoms if g.frame >= 0]).astype(np.int64)
        self._arm, self._still = arm[self._frames], np.zeros(dynamics.frames)
        self._dynamics, self._overlap = dynamics, overlap
        start = dynamics.place(dynamics.start()[0])
        self.check(start, start, 0.0)

    def check(self, begin: Placement, end: Placement, t: float) -> float:
        """Deepest overlap that prescribed motions leave at the end of a step, m, 0 if none.

        The way there is followed in so many parts, each frame on a screw, that none passes through another unseen.

        Raises
        ------
        ValueError
            Where it is deeper than what is taken, at the end or on the way: naming both, the depth and the time t.
        """
        self._check_limits(end, t)
        if not self._frames.size:
            return 0.0
        old, new = ([pin.SE3(at.R[f], at.x[f]) for f in self._frames] for at in (begin, end))
        ways = [pin.log6(a.actInv(b)) for a, b in zip(old, new, strict=True)]
        moved = np.array([(np.linalg.norm(way.linear), np.linalg.norm(way.angular)) for way in ways])
        # Two may meet halfway.
        farthest = 2.0 * float((moved[:, 0] + self._arm * moved[:, 1]).max())
        x, R, parts = end.x.copy(), end.R.copy(), math.ceil(min(farthest / self._radius.min(), MOST))
        for part in range(1, parts):
            for f, a, way in zip(self._frames, old, ways, strict=True):
                there = a * pin.exp6(part / parts * way)
                x[f], R[f] = there.translation, there.rotation
            self._deepest(x, R, t)
        return self._deepest(end.x, end.R, t)

    def _check_limits(self, there: Placement, t: float) -> None:
        for tree, links in zip(self._dynamics.trees, there.links, strict=True):
            lower, upper = tree.limits()
            beyond = np.where(tree.held, np.maximum(lower - links.angle, links.angle - upper), -math.inf)
            j = int(beyond.argmax())
            if beyond[j] > self._overlap * JOINT:
                joint = tree.joint_of(j)
                raise ValueError(
                    f"prescribed motions contradict: joint '{tree.name}/{joint}' is {beyond[j]:.3g} rad or m beyond "
                    f"its limits, {lower[j]:.6g} and {upper[j]:.6g}, at t = {t:.6g} s"
                )

    def _deepest(self, x: Array, R: Array, t: float) -> float:
        found, _ = self._detector.find(x, R, self._still, ContactMemory.empty())
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
