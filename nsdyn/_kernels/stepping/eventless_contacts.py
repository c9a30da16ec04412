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


@kernel
def all_twists(movers, poses, v):
    """Return (linear, angular) velocities of all frames at their poses (x, R), world axes; movers as in `opened`."""
    (x, R), linear, angular = poses, np.empty(poses[0].shape), np.empty(poses[0].shape)
    motion.twists(R, v, movers[0], linear, angular)
    links.twists(movers[1], x, v, linear, angular)
    return linear, angular


@kernel
def all_rates(movers, poses, v, v_free, h):
    """Return `all_twists` of the free acceleration, which changes v to v_free in h s."""
    rate = np.empty(v.size)
    for i in range(rate.size):
        rate[i] = (v_free[i] - v[i]) / h
    return all_twists(movers, poses, rate)


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
    v_begin, here, there = col.velocity(old, col.V, size), col.poses(old, n), col.poses(w, n)
    begun, gap = col.twists(old, n), before[2][0].copy()
    closed, tol, bounces_of = num[col.GAP_TOL], num[col.TOL], (num[col.HALF], num[col.LEAST])
    if num[col.ELASTIC] > 0.0 and before[2][2].any():
        moving = begun, all_rates(movers_begun, here, v_begin, v, h)
        active_set.parting(before, here[0], np.zeros(gap.size), moving, (closed, tol, bounces_of), gap)
    if touching.known(found[0][4], before[0][4], gap, closed, out):
        return out.size
    parts = np.empty(gap.size)
    touching.approach(before, here[0], begun, parts)
    active_set.captured(
        found,
        there[0],
        (inscribed, num[col.DEPTH]),
        np.zeros(out.size),
        (all_twists(movers, there, v_begin), all_twists(movers, there, v), all_rates(movers, there, v_begin, v, h)),
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
    (names, _, scalars), x, rates = active, col.vectors(w, col.X, n), all_twists(movers, col.poses(w, n), rate)
    for c in range(names.shape[1]):
        closes = end_gap[c] + num[col.THETA] * num[col.STEP] * (local[2, 3 * c] + local[3, 3 * c]) <= 0.0
        if scalars[2, c] > 0.0 and local[1, 3 * c] < 0.0 and closes:
            weight, bounces_of = touching.weight_of(c, active, x, rates), (num[col.HALF], num[col.LEAST])
            resting = num[col.TOL] + active_set.rests_of(weight, scalars[2, c], bounces_of) / scalars[2, c]
            if local[0, 3 * c] < -resting:
                return True
    return False
