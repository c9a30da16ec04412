"""Contact detection and active set of a move, in the arrays of `columns`."""

import numpy as np

from nsdyn._kernels.collision.search import LEFT, gather, seek
from nsdyn._kernels.compiled import kernel, no_alloc
from nsdyn._kernels.dynamics import links, motion
from nsdyn._kernels.stepping import active_set, touching
from nsdyn._kernels.stepping import columns as col

DONE, OTHERWISE, DETECT, SOLVE, DETECT_AHEAD, MORE, MOVE, EVENT = range(8)
"""Codes with which a call returns. `DONE`: the step is made. `OTHERWISE`: it is not eventless, or not for the kernel.
`DETECT`: Python has to place the geoms, or call Coal, at the midpoint. `SOLVE`: Python has to solve the problem.
`DETECT_AHEAD`: as `DETECT`, at the end. `MORE`: the memory for contacts is too small. `MOVE`: Python has to move the
trees to the end. `EVENT`: the move is made, but is no whole step. After `DETECT`, `SOLVE`, `DETECT_AHEAD` and `MOVE`
the next call continues with what Python has done."""


@no_alloc
def all_twists(movers, x, R, v, linear, angular):
    """Linear and angular velocities of all frames at x (n, 3), world axes, into (n, 3) each; movers as in `opened`."""
    motion.twists(R, v, movers[0], linear, angular)
    links.twists(movers[1], x, v, linear, angular)


@no_alloc
def detect(detection, ready, detected_at, begun, into, head, which, room):
    """Detect contacts, `DONE`; else `DETECT` if Python has to help, `MORE` if they exceed the memory.

    Contacts keep their keys from begun = (earlier contacts, next key). room = (most contacts, most numbers of each).
    """
    (geoms, pairs, limit, tolerance), (before, next_key), (most, wide) = detection, begun, room
    count = seek(geoms, pairs, limit, ready, detected_at)
    if count == LEFT:
        return DETECT
    head[which] = head[col.NEEDED] = count
    if count > most or wide * count > into[0].size:
        return MORE
    found = col.contacts(into, count)
    head[col.KEY_MIDDLE + which - col.MIDDLE] = gather(geoms, pairs, tolerance, before, next_key, found)
    into[1][col.FOUND_NAMES * count + col.MADE] = 0
    return DONE


@kernel
def capture(scene, bodies, contacts, last, old, w, located, out):
    """Active set of the found contacts, into out (nc,), as in `nsdyn.stepping.active_set.captured`; returns its size.

    scene = (numbers, size), bodies = (movers at the beginning, movers at the midpoint, radii of balls inside the
    shapes), contacts = (those at the beginning, those found), last = (keys, pairs, states) of the contacts that acted
    last, old: the state at the beginning.
    """
    (num, size), (movers_begun, movers, inscribed) = scene, bodies
    h, n, (before, found), v = num[col.STEP], size[0], contacts, col.velocity(w, col.V_FREE, size)
    v_begin, x, at = col.velocity(old, col.V, size), col.vectors(w, col.X, n), col.vectors(old, col.X, n)
    rate, twists, gap = np.empty(v.size), np.empty((5, 2, n, 3)), before[2][0].copy()
    for i in range(rate.size):
        rate[i] = (v[i] - v_begin[i]) / h
    closed, tol, bounces_of = num[col.GAP_TOL], num[col.TOL], (num[col.HALF], num[col.LEAST])
    begun, R, R_begun = (twists[3, 0], twists[3, 1]), col.rotations(w, col.R_THERE, n), col.rotations(old, col.R, n)
    all_twists(movers_begun, at, R_begun, v_begin, *begun)
    if num[col.ELASTIC] > 0.0 and before[2][2].any():
        all_twists(movers_begun, at, R_begun, rate, twists[4, 0], twists[4, 1])
        moving = begun, (twists[4, 0], twists[4, 1])
        active_set.parting(before, at, np.zeros(gap.size), moving, (closed, tol, bounces_of), gap)
    if touching.known(found[0][4], before[0][4], gap, closed, out):
        return out.size
    parts = np.empty(gap.size)
    touching.approach(before, at, begun, parts)
    all_twists(movers, x, R, v_begin, twists[0, 0], twists[0, 1])
    all_twists(movers, x, R, v, twists[1, 0], twists[1, 1])
    all_twists(movers, x, R, rate, twists[2, 0], twists[2, 1])
    active_set.captured(
        found,
        x,
        (inscribed, num[col.DEPTH]),
        np.zeros(out.size),
        ((twists[0, 0], twists[0, 1]), (twists[1, 0], twists[1, 1]), (twists[2, 0], twists[2, 1])),
        (before[0][4], gap, parts, closed),
        last,
        (num[col.THETA] * h, h, tol, bounces_of),
        located,
        out,
    )
    return out.sum()


@no_alloc
def take(found, which, into):
    """Copy the contacts `which` (nc,) of those found."""
    k = 0
    for c in range(which.size):
        if which[c]:
            for i in range(5):
                into[0][i, k] = found[0][i, c]
            for i in range(4):
                for j in range(3):
                    into[1][i, k, j] = found[1][i, c, j]
            for i in range(3):
                into[2][i, k] = found[2][i, c]
            k += 1


@no_alloc
def gap_rule_of(num):
    """The `GapRule` of the numbers of a system."""
    return num[col.GAP_TOL], num[col.SHALLOW], num[col.THETA] * num[col.STEP], num[col.UNTIL]


@kernel
def strikes(num, n, movers, active, local, end_gap, rate, w):
    """Whether any contact of the active set strikes, as in `nsdyn.stepping.collisions.striking`."""
    (names, _, scalars), x, rates = active, col.vectors(w, col.X, n), np.empty((2, n, 3))
    all_twists(movers, x, col.rotations(w, col.R_THERE, n), rate, rates[0], rates[1])
    for c in range(names.shape[1]):
        closes = end_gap[c] + num[col.THETA] * num[col.STEP] * (local[2, 3 * c] + local[3, 3 * c]) <= 0.0
        if scalars[2, c] > 0.0 and local[1, 3 * c] < 0.0 and closes:
            weight, bounces_of = touching.weight_of(c, active, x, (rates[0], rates[1])), (num[col.HALF], num[col.LEAST])
            resting = num[col.TOL] + active_set.rests_of(weight, scalars[2, c], bounces_of) / scalars[2, c]
            if local[0, 3 * c] < -resting:
                return True
    return False
