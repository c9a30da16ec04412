"""Contact forces to draw: summed over the steps between keyframes, in the axes of the bodies on which they act."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from nsdyn.recording.body_motion import of_frame
from nsdyn.recording.shares import contact_axes, distinct
from nsdyn.recording.tables import body_names, contact_columns, contact_steps, impulses
from nsdyn.tools.arrays import Array, Index

if TYPE_CHECKING:
    from nsdyn.recording.trajectory import Trajectory


class Forces(NamedTuple):
    """Mean forces of the steps before each keyframe.

    Attributes
    ----------
    keyframe : ndarray, shape (n,)
        The keyframe, from 1 on, that ends the steps.
    frame : ndarray, shape (n,)
        Moving frame of the body on which the force acts: body 2, or body 1 if body 2 is fixed.
    point, force : ndarray, shape (n, 3)
        m and N, in the axes and from the origin of the frame.
    """

    keyframe: Index
    frame: Index
    point: Array
    force: Array


def between(trajectory: Trajectory, rows: Index, by: str) -> Forces:
    """Return the contact forces between the recorded states `rows`, ascending; ValueError without contacts.

    Parameters
    ----------
    trajectory : Trajectory
    rows : ndarray of int
        Indices of states; each keyframe has the steps since the previous keyframe.
    by : {"pair", "point"}
        "pair": one force for each pair of bodies, at its centre of pressure. Force and centre follow from the solver's
        impulses; on flat faces neither depends on how redundant contacts share the impulses. "point": one force for
        each contact point; redundant contacts get the impulses of least norm in each step (`nsdyn.recording.shares`).
    """
    c, step = contact_columns(trajectory), contact_steps(trajectory)
    k = np.flatnonzero((step > rows[0]) & (step <= rows[-1]))
    step, c = step[k], {name: x[k] for name, x in c.items() if name != "offset"}
    impulse = impulses(trajectory, k) if by == "point" else c["impulse"]
    geoms = trajectory.scene["geoms"]
    frame_of = np.array([geom["frame"] for geom in geoms], dtype=np.int64)
    link_of = np.unique(body_names(trajectory), return_inverse=True)[1]
    second = frame_of[c["geom2"]] >= 0
    pushed, other = (np.where(second, *pair) for pair in ((c["geom2"], c["geom1"]), (c["geom1"], c["geom2"])))
    push = np.where(second, 1.0, -1.0)[:, None] * np.einsum("ci,cij->cj", impulse, contact_axes(c))
    frame, point = frame_of[pushed], c["point"].copy()
    order = np.argsort(frame, kind="stable")
    for on in np.split(order, np.flatnonzero(np.diff(frame[order])) + 1 if order.size else []):
        if not on.size:
            continue
        motion = of_frame(trajectory, int(frame[on[0]]))
        turn = Rotation.from_quat(motion.quaternion[step[on]]).inv()
        point[on] = turn.apply(point[on] - motion.position[step[on]])
        push[on] = turn.apply(push[on])
    keyframe = np.searchsorted(rows, step)
    pair = np.column_stack([keyframe, link_of[pushed], link_of[other], frame])
    if by == "point":
        pair = np.column_stack([pair, c["geom1"], c["geom2"], c["key"]])
    groups, member = distinct(pair)
    weight = np.maximum(impulse[:, 0], 0.0)
    n = len(groups)

    def total(values: Array) -> Array:
        return np.stack([np.bincount(member, column, n) for column in values.T], axis=1)

    weights = np.maximum(np.bincount(member, weight, n), 1e-300)[:, None]
    force, mean = total(push), total(weight[:, None] * point) / weights
    length = np.diff(trajectory.t[rows])[groups[:, 0] - 1] / trajectory.every  # of the recorded steps
    return Forces(groups[:, 0], groups[:, 3], mean, force / length[:, None])
