"""Islands: groups of bodies that may touch within a step."""

import math

import numpy as np

from nsdyn._kernels.collision.broadphase import bounds
from nsdyn._kernels.compiled import kernel
from nsdyn._kernels.problem.blocks import number, unite
from nsdyn._kernels.sorting import order as order_of
from nsdyn._kernels.stepping.options import OPTIONS
from nsdyn._kernels.vectors import square

WORK, EVENT = OPTIONS.work, OPTIONS.event


@kernel
def located(node, frames, out):
    """Whether events are located in the island of each node, into out (nodes,), from frames (2, nc) of the contacts."""
    parent, label = np.arange(out.size), np.empty(out.size, np.int64)
    for c in range(frames.shape[1]):
        a, b = node[frames[0, c]], node[frames[1, c]]
        if a >= 0 and b >= 0:
            unite(parent, a, b)
    size = np.zeros(number(parent, label), np.int64)
    for c in range(frames.shape[1]):
        k = max(node[frames[0, c]], node[frames[1, c]])
        if k >= 0:
            size[label[k]] += 1
    for k in range(out.size):
        out[k] = EVENT * size[label[k]] <= WORK


@kernel
def islands(lower, upper, node, first, second, label):
    """Connected components of nodes whose boxes overlap, or that a contact joins; returns their number.

    lower, upper (geoms, 3) bound the geoms, `node` (geoms,) are their nodes, first and second (nc,) the nodes of the
    contacts; -1 for a fixed or kinematic body. The labels go into label (nodes,), ascending with the least node of each
    component.
    """
    parent = np.arange(label.size)
    for c in range(first.size):
        if first[c] >= 0 and second[c] >= 0:
            unite(parent, first[c], second[c])
    order = order_of(lower[:, 0].copy())
    for a in range(order.size):
        i = order[a]
        if node[i] < 0:
            continue
        for b in range(a + 1, order.size):
            j = order[b]
            if lower[j, 0] > upper[i, 0]:
                break
            if node[j] < 0 or node[j] == node[i]:
                continue
            apart = lower[j, 1] > upper[i, 1] or lower[i, 1] > upper[j, 1]
            if not (apart or lower[j, 2] > upper[i, 2] or lower[i, 2] > upper[j, 2]):
                unite(parent, node[i], node[j])
    return number(parent, label)


@kernel
def sweep(fields, one, other, arm, frames, boxes, wide):
    """Enlarge boxes (lower, upper), (geoms, 3), of geoms at poses one = (x, R) by the boxes at poses `other`.

    Into wide (frames,) goes how far geoms may leave the straight way between both poses: by rotation, with `arm`
    (frames,), and in frames that are not free by `bent` times the length of the way. `fields` are those of `Geometry`;
    frames = (number of free ones, bent).
    """
    (free, bent), (lower, upper) = frames, boxes
    low, high = lower.copy(), upper.copy()
    bounds(fields, *other, low, high)
    for g in range(lower.shape[0]):
        for i in range(3):
            lower[g, i], upper[g, i] = min(lower[g, i], low[g, i]), max(upper[g, i], high[g, i])
    for f in range(wide.size):
        turn, way = 0.0, 0.0  # the turn is at least 0.4 of the angle, or of a radian
        for i in range(3):
            way += square(other[0][f, i] - one[0][f, i])
            for j in range(3):
                turn = max(turn, abs(other[1][f, i, j] - one[1][f, i, j]))
        far = arm[f] * min(1.0, turn * turn)
        wide[f] = max(wide[f], far if f < free else far + bent * math.sqrt(way))
