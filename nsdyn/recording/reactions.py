"""Reactions in the joints and loops of articulations: what a recorded motion takes, by the balance of its links.

A joint passes on what its child and all beyond it need: in a step of h with the change of velocity Δv, at the
configuration where the impulses act,

    Σ (I a + v × I v) h - gravity h - contacts - loops,

by the recursive Newton–Euler algorithm. It is of second order in h, as the motion is.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from nsdyn.recording.retrace import Trees, trees
from nsdyn.tools.arrays import Array

if TYPE_CHECKING:
    from nsdyn.recording.trajectory import Trajectory

__all__ = ["reactions"]


def reactions(trajectory: Trajectory) -> dict[str, Array]:
    """Mean reactions in each step by "articulation/joint" and "articulation/loop", (n, 6): force N, then torque N m.

    Of joints on the child at the joint's origin, of loops on the link of the first frame at its place; world axes. NaN
    where a recording does not tell.
    """
    found, n, scene = trees(trajectory), trajectory.steps, trajectory.scene
    # On which links external wrenches act is not recorded: a joint may bear one that moves nothing.
    if isinstance(found, str) or found.missing or trajectory.meta.get("external_force", True):
        loops = [
            (a["name"], loop["name"]) for a in scene["articulations"] for loop in a.get("model", {}).get("loops", ())
        ]
        named = [(a["name"], joint) for a in scene["articulations"] for joint in a.get("joints", ())] + loops
        return {f"{owner}/{name}": np.full((n, 6), np.nan) for owner, name in named}
    out: dict[str, Array] = {}
    for i, m in enumerate(found.mechanisms):
        names = [f"{m.name}/{name}" for name in (*m.joints, *m.loop_names)]
        steps = np.array([_of_step(found, i, k) for k in range(n)]).reshape(n, len(names), 6)
        out |= {name: steps[:, k] / trajectory.dt for k, name in enumerate(names)}
    return out


def _of_step(found: Trees, tree: int, k: int) -> Array:
    """Impulses of the joints, then of the loops of a tree in step k, (joints + loops, 6)."""
    m, theta = found.mechanisms[tree], float(found.trajectory.meta["theta"])
    joints, loops, way = np.zeros((len(m.joints), 6)), np.zeros((m.loops, 6)), found.way(tree, k)
    v, points = found.state(tree, k)[1], found.trajectory.columns["contacts/point"]
    for kick, end in zip(way.kicks, way.flows[1::2], strict=True):
        pushes = [
            (joint, np.concatenate((push, np.cross(points[row], push))))
            for row, side, joint in kick.touches
            for push in [(2 * side - 1) * found.impulses[row]]
        ]
        flights = [((1.0 - theta) * kick.h, kick.before), (theta * kick.h, kick.after)]
        moved = kick.q, end.v - v, flights, kick.h
        tau, passed = m.passed(*moved, pushes)
        if m.loops:
            held = m.held(kick.q, tau - kick.given.sum(axis=0) - kick.stiff.sum(axis=0))
            _, passed = m.passed(*moved, [*pushes, *(push for both in held for push in both)])
            for loop, ((_, impulse), _) in enumerate(held):
                place = m.closure(loop)
                loops[loop] += np.concatenate((impulse[:3], impulse[3:] - np.cross(place, impulse[:3])))
        joints += passed[1:]
        v = end.v
    return np.concatenate((joints, loops))
