"""Reactions in the joints and loops of articulations, from the recorded motion and the balance of momentum of links.

A joint passes on the force that its child and all links beyond it need. Over a step of length h, with the momenta p of
these links, linear and about the world's origin, this force is

    Σ Δp - gravity h - contacts - external wrenches - loops,

divided by h. Position projections, which displace links without momentum, are undone first. Forces are therefore exact
means over the step. Moments are about the joint at its position halfway. They are of second order in h, of first order
in steps with impacts. The reactions of loops are those that explain the components of the passed wrenches along the
coordinates, after subtraction of the recorded impulses on the coordinates.

Reactions are computed on demand and not during the run, which would cost 0.07 ms per step of a quadruped. The recording
has only the data that cannot be computed later: external wrenches, and the impulses of contacts that it leaves out
(`/links/impulse`). `nsdyn joints` writes the reactions as a table.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from nsdyn.recording import link_names
from nsdyn.recording.columns import JOINTS, ON_LINKS
from nsdyn.recording.retrace import Trees, trees
from nsdyn.recording.tables import contact_steps, left_out
from nsdyn.tools.arrays import Array, Index

if TYPE_CHECKING:
    from nsdyn.recording.trajectory import Trajectory

SHIFT = 4
"""Index of the projections in `JOINTS`; the entries before the external wrenches act on the joints."""


def reactions(trajectory: Trajectory, steps: Index) -> dict[str, Array]:
    """Return mean reactions in some steps, from 0 on, by names of joints and loops, (., 6): force N, then torque N m.

    Reactions of joints act on the child at the joint's origin, those of loops on the link of the first frame at that
    frame; world axes. NaN without a model that can be built.
    """
    found, c = trees(trajectory), trajectory.columns
    if isinstance(found, str):
        known = [*link_names.joints(trajectory.scene), *link_names.loops(trajectory.scene)]
        return {name: np.full((steps.size, 6), np.nan) for name in known}
    count = len(link_names.joints(trajectory.scene))
    outside = c[ON_LINKS].copy() if ON_LINKS in c else np.zeros((trajectory.steps, count, 6))
    if not left_out(trajectory):
        link_names.by_contacts(link_names.carriers(trajectory.scene), c, contact_steps(trajectory) - 1, outside)
    out, first = dict[str, Array](), 0
    for i, m in enumerate(found.mechanisms):
        own = slice(first, first + len(m.joints))
        labels, first = [f"{m.name}/{name}" for name in (*m.joints, *m.loop_names)], own.stop
        means = _of_tree(found, i, steps, outside[steps, own]) / (trajectory.dt * trajectory.every)
        out |= {name: means[:, k] for k, name in enumerate(labels)}
    return out


def _of_tree(found: Trees, tree: int, steps: Index, outside: Array) -> Array:
    """Return impulses of the joints, then of the loops of a tree, (n, joints + loops, 6), each about its own point."""
    m, t, rows = found.mechanisms[tree], found.trajectory, found.rows[tree]
    (q, v), (end, end_v) = found.state(tree, steps), found.state(tree, steps + 1)
    shift, h = t.columns[JOINTS[SHIFT]][steps, rows], t.dt * t.every
    for k in np.flatnonzero(shift.any(axis=1)).tolist():
        end[k], end_v[k] = m.lifted(end[k], end_v[k], -shift[k])
    middle = np.array([pin.interpolate(m.model, *both, 0.5) for both in zip(q, end, strict=True)]).reshape(q.shape)
    weight, origins = m.weights(middle)
    needs = m.momenta(end, end_v) - m.momenta(q, v) - h * weight - outside
    loops = np.zeros((steps.size, len(m.loop_names), 6))
    if m.loop_names:
        given = sum(t.columns[name][steps, rows] for name in JOINTS[: SHIFT - 1]) - m.armature * (end_v - v)
        passed = m.passed(needs)
        for k, at in enumerate(middle):
            damped = m.damping * np.array(pin.difference(m.model, q[k], end[k]))
            explained = given[k] - (damped + h * m.stiffness * m.stretch(at))
            for loop, pushes in enumerate(m.held(at, m.along(at, passed[k]) - explained)):
                for joint, push in pushes:
                    if joint:
                        needs[k, joint - 1] -= push
                loops[k, loop] = _about(m.closure(loop), pushes[0][1])
    return np.concatenate((_about(origins, m.passed(needs)), loops), axis=1)


def _about(point: Array, wrench: Array) -> Array:
    """Return force and moment about a point from those about the world's origin."""
    return np.concatenate((wrench[..., :3], wrench[..., 3:] - np.cross(point, wrench[..., :3])), axis=-1)
