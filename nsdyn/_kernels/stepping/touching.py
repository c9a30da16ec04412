"""Matching of contacts with earlier ones, reuse of detection, normal velocities of contacts, and how far they turn.

Contacts are (names, points, scalars), the fields of `nsdyn.collision.contacts.ContactSet`.
"""

import numpy as np

from nsdyn._kernels.compiled import kernel, no_alloc
from nsdyn._kernels.sorting import order, place_of
from nsdyn._kernels.stepping.options import OPTIONS
from nsdyn._kernels.vectors import along, cross, dot, minus, row

TURNS = OPTIONS.turn

LEAST = 5e-324
"""The least positive impulse, N·s."""


@no_alloc
def places(old_key, new_key, out):
    """Index of every new key among the old ones, -1 for a key that is new, into out (nc,)."""
    known = 0
    while known < min(old_key.size, new_key.size) and old_key[known] == new_key[known]:
        out[known] = known
        known += 1
    if known < new_key.size:
        sorted_places(old_key, new_key, known, out)


@kernel
def sorted_places(old_key, new_key, begin, out):
    """`places` from the index `begin` on."""
    old = order(old_key)
    keys = old_key[old]
    for c in range(begin, new_key.size):
        k = place_of(keys, new_key[c])
        out[c] = old[k] if k < keys.size and keys[k] == new_key[c] else -1


@kernel
def known(key, old_key, old_gap, closed, out):
    """Contacts that are among the old ones with gap up to `closed`, into out (nc,); whether all are."""
    place, every = np.empty(key.size, np.int64), True
    places(old_key, key, place)
    for c in range(key.size):
        out[c] = place[c] >= 0 and old_gap[place[c]] <= closed
        every = every and out[c]
    return every


@kernel
def pressed(key, old_key, states, out):
    """Contacts that had an impulse by the states of the old ones, into out (nc,)."""
    place = np.empty(key.size, np.int64)
    places(old_key, key, place)
    for c in range(key.size):
        out[c] = place[c] >= 0 and states[place[c]] > 0


@no_alloc
def detection_pose(detected_at, now, arm, tol, out):
    """Poses for contact detection, into out = (x, R, reach); whether all frames keep their pose.

    Each frame keeps its earlier pose until one of its points, at most `arm` (n,) from its origin, moves by tol, or its
    reach grows by tol. The contacts found of a pair therefore depend on its two frames alone.
    """
    (x, R, reach), (x_now, R_now, reach_now), (x_out, R_out, reach_out), every = detected_at, now, out, True
    for f in range(arm.size):
        shift, turn = 0.0, 0.0
        for i in range(3):
            shift = max(shift, abs(x[f, i] - x_now[f, i]))
            for j in range(3):
                turn = max(turn, abs(R[f, i, j] - R_now[f, i, j]))
        same = not (shift + 3.0 * turn * arm[f] > tol or reach_now[f] > reach[f] + tol)
        for i in range(3):
            x_out[f, i] = x[f, i] if same else x_now[f, i]
            for j in range(3):
                R_out[f, i, j] = R[f, i, j] if same else R_now[f, i, j]
        reach_out[f], every = reach[f] if same else reach_now[f], every and same
    return every


@no_alloc
def approach_of(c, contacts, x, twists):
    """Normal velocity of contact c, m/s; frames at x have twists = (linear, angular), as in `begin_velocities`."""
    (names, points, _), (linear, angular) = contacts, twists
    p, w = row(points[0], c), (0.0, 0.0, 0.0)
    for s in range(2):
        f = names[2 + s, c]
        if f >= 0:
            arm = minus(p, row(x, f))
            w = along(w, -1.0 if s == 0 else 1.0, along(row(linear, f), 1.0, cross(row(angular, f), arm)))
    return dot(row(points[1], c), w)


@no_alloc
def approach(contacts, x, twists, out):
    """`approach_of` of all contacts, into out (nc,)."""
    for c in range(out.size):
        out[c] = approach_of(c, contacts, x, twists)


@no_alloc
def weight_of(c, contacts, x, rates):
    """One entry of `weights`: that of contact c."""
    (names, points, _), (linear, angular) = contacts, rates
    p, n, total = row(points[0], c), row(points[1], c), 0.0
    for f in (names[2, c], names[3, c]):
        if f >= 0:
            total += abs(dot(n, along(row(linear, f), 1.0, cross(row(angular, f), minus(p, row(x, f))))))
    return total


@no_alloc
def weights(contacts, x, rates, out):
    """Sum of the free normal accelerations of both bodies, |a1·n| + |a2·n| per contact, into out (nc,), m/s².

    rates = (linear, angular) are accelerations of the frames, used as in `approach_of`. The sum, not the difference: of
    two bodies that fall together the difference is 0 and nothing could rest by it, but one of them is supported.
    """
    for c in range(out.size):
        out[c] = weight_of(c, contacts, x, rates)


@kernel
def last_status(names, geoms, warm, out):
    """State of each contact in the last move, 0 open, 1 stick, 2 slip, into out (nc,).

    warm = (keys, pairs of shapes, states) are the contacts that acted in that move; a pair is coded with the number
    `geoms` of shapes. A contact whose key is new takes the state of contacts of its pair whose keys no longer exist: it
    has rolled far.
    """
    key, (warm_key, warm_pair, warm_status) = names[4], warm
    place, kept = np.empty(key.size, np.int64), np.empty(warm_key.size, np.int64)
    places(warm_key, key, place)
    places(key, warm_key, kept)
    for c in range(key.size):
        out[c] = warm_status[place[c]] if place[c] >= 0 else 0
        if place[c] < 0:
            for k in range(warm_key.size):
                if warm_pair[k] == names[0, c] * geoms + names[1, c] and kept[k] < 0:
                    out[c] = max(out[c], warm_status[k])


@kernel
def striking_speed(contacts, x, twists, warm, geoms, closed):
    """Least normal velocity of contacts that may strike, m/s, 0 if none is negative.

    These are the closed contacts, except those that had an impulse in the last move and no restitution: they turn with
    their bodies, and approach a little without an impact.
    """
    names, _, scalars = contacts
    was, least = np.empty(names.shape[1], np.int8), 0.0
    last_status(names, geoms, warm, was)
    for c in range(was.size):
        if scalars[0, c] <= closed and (was[c] == 0 or scalars[2, c] > 0.0):
            least = min(least, approach_of(c, contacts, x, twists))
    return least


@no_alloc
def turns_far(c, k, begin, here, ahead):
    """Whether the lever of contact c about some body turns by more than `TURNS` up to the midpoint.

    k is its place among the contacts at the beginning. About links and driven bodies, or if the contact is new (-1),
    the lever turns with the body, in `ahead` s. `begin` and `here` are as in `law.local_velocities`.
    """
    (_, old_points, _), x_old, (_, angular), (_, _, _, free) = begin
    (names, points, _), _, x = here
    for s in range(2):
        f = names[2 + s, c]
        if k >= 0 and 0 <= f < free:
            arm, old = minus(row(points[0], c), row(x, f)), minus(row(old_points[0], k), row(x_old, f))
            way = minus(arm, old)
            if dot(way, way) > TURNS * TURNS * min(dot(arm, arm), dot(old, old)):
                return True
        elif f >= 0 and ahead * ahead * dot(row(angular, f), row(angular, f)) > TURNS * TURNS:
            return True
    return False
