"""The active set of contacts of a move, and times of impact. Names are those of `nsdyn.stepping.active_set`."""

import math

import numpy as np

from nsdyn._kernels.collision.advancement import widest
from nsdyn._kernels.collision.geometry import Placed, place
from nsdyn._kernels.collision.search import fields_of, room_of
from nsdyn._kernels.compiled import kernel, no_alloc
from nsdyn._kernels.stepping.touching import approach_of, known, last_status, places, pressed, weight_of
from nsdyn._kernels.vectors import row

DEEPER = 1.1
"""Overlap along a normal over that of the bodies, up to which the normal separates them where they are deep."""


@no_alloc
def rests_of(weight, e, bounces):
    """Separating speed up to which a contact of restitution e rests; bounces = (½ dt, least 1 - e that counts)."""
    return bounces[0] * weight * max(1.0 - e, bounces[1])


@no_alloc
def parting(contacts, x, carried, twists, sizes, out):
    """Gaps, into out (nc,); infinite for closed elastic contacts that separate too fast to rest.

    Contacts and twists = (velocity, free acceleration) are as in `touching.approach_of`. carried (nc,) is what moving
    surfaces add to normal velocities, m/s; sizes = (gap tolerance, tolerance of the solver, bounces).
    """
    (velocity, rate), (closed, tol, bounces), (_, _, scalars) = twists, sizes, contacts
    for c in range(out.size):
        out[c] = scalars[0, c]
        if scalars[2, c] > 0.0 and scalars[0, c] <= closed:
            rests = rests_of(weight_of(c, contacts, x, rate), scalars[2, c], bounces)
            if approach_of(c, contacts, x, velocity) + carried[c] > tol + rests:
                out[c] = math.inf


@kernel
def captured(contacts, x, near, carried, twists, before, warm, sizes, located, out):
    """The active set of a move: contacts whose impulses may act although impacts are located, into out (nc,).

    These are the contacts `known` to be closed where the move begins. A further contact is active if it stays shallow
    within the move, its pair is not `located`, and it does not strike elastically.

    Parameters
    ----------
    contacts, x
        As in `touching.approach_of`.
    near : tuple
        Radii of balls inside the shapes, m, and the fraction of the smaller radius at which a contact is deep.
    carried : ndarray, shape (nc,)
        What moving surfaces add to normal velocities, m/s.
    twists : tuple
        Twists of the velocity where the move begins, of the free velocity and of the free acceleration.
    before : tuple
        Keys, gaps, normal velocities and gap tolerance of the contacts where the move begins.
    warm : tuple
        Keys, pairs and status of the warm start.
    sizes : tuple
        Lengths of the second half of the move and of the move, s; tolerance, m/s; bounces as in `rests_of`.
    located : ndarray of int
        Pairs of shapes whose impact is to be located.
    out : ndarray of bool
    """
    (names, _, scalars), (inscribed, depth) = contacts, near
    gap, restitution = scalars[0], scalars[2]
    ahead, h, tol, bounces = sizes
    begin, free, rate = twists
    before_key, before_gap, parts, closed = before
    status, place = np.empty(out.size, np.int8), np.empty(out.size, np.int64)
    known(names[4], before_key, before_gap, closed, out)
    places(before_key, names[4], place)
    last_status(names, inscribed.size, warm, status)
    for c in range(out.size):
        k = place[c]
        if out[c] or (k >= 0 and before_gap[k] == math.inf):  # an infinite gap: the contact separates
            continue
        i, j = names[0, c], names[1, c]
        pair, deep = i * inscribed.size + j, depth * min(inscribed[i], inscribed[j])
        weight, e = weight_of(c, contacts, x, rate), restitution[c]
        u = approach_of(c, contacts, x, begin)
        if not status[c] > 0:
            # Of two bodies that fall together either may be supported, unknown here: assume that the other falls alone.
            u = min(approach_of(c, contacts, x, free), u - h * weight)
        u += carried[c]
        shallow = gap[c] + ahead * u > -deep
        if not shallow and k >= 0 and before_gap[k] + h * parts[k] > -deep:  # approaches only because its rows turn
            shallow = status[c] > 0
            if before_gap[k] <= deep:  # another pressed contact of the pair supports it
                for l in range(warm[1].size):
                    shallow = shallow or (warm[1][l] == pair and warm[2][l] > 0)
        for b in located:
            shallow = shallow and b != pair
        out[c] = shallow and (e == 0.0 or u > -(tol + rests_of(weight, e, bounces) / e))


@no_alloc
def overrun(geoms, contacts, R, ends, last, presses, deep, out):
    """Contacts whose normals do not separate their bodies although they press, into out (nc,); whether there are any.

    They did not press in the last move. Along their normals their geoms overlap by more than they do at all, where the
    impulses act and where the move ends: a corner slips off the face on which it was to land, an end presses while the
    bodies cross elsewhere.

    Parameters
    ----------
    geoms : tuple
        The packed arrays of the geoms, as in `search`.
    contacts : (names, points, scalars)
        The active set, as it is where the frames have the rotations R (frames, 3, 3).
    ends : tuple
        Where the impulses act, and where the move ends: poses (x, R) of the frames, and the contacts there.
    last : tuple
        Keys and states of the last active set.
    presses : ndarray of bool, shape (nc,)
    deep : tuple
        Radii of balls inside the shapes, m, and the fraction of the smaller radius at which an overlap counts.
    out : ndarray of bool, shape (nc,)
    """
    (names, points, _), (radii, least), some = contacts, deep, False
    pressed(names[4], *last, out)
    for c in range(out.size):
        out[c] = presses[c] and not out[c]
        some = some or out[c]
    if not some:
        return False
    fields, room = fields_of(geoms), room_of(geoms)
    for (x, turned), found in ends:
        if not some:
            break
        place(fields, x, turned, *room)
        some = False
        for c in range(out.size):
            if out[c]:
                i, j, gap = names[0, c], names[1, c], 0.0
                for k in range(found[0].shape[1]):
                    if found[0][0, k] == i and found[0][1, k] == j:
                        gap = min(gap, found[2][0, k])
                apart, _ = widest(Placed(*fields, *room), names, c, row(points[1], c), R, turned)
                out[c] = apart < DEEPER * gap - least * min(radii[i], radii[j])
                some = some or out[c]
    return some


@no_alloc
def touch(gap, u, change, sizes):
    """Time of impact, s, of a contact that ends a move with `gap` and speed u, changed by `change`; infinite for none.

    The gap is the parabola gap - u x + fall x²/2 in the time x before the end. If it ends in penetration the impact is
    at the least positive root.
    """
    _, _, theta, h = sizes
    # Bodies move with the velocity of the end for the fraction θ of the move.
    speed, fall = u + (2.0 * theta - 1.0) * change, 2.0 * theta / h * change
    root, x = math.sqrt(max(speed * speed - 2.0 * fall * gap, 0.0)), 0.0
    if speed < 0.0:
        x = 2.0 * gap / (speed - root)
    elif fall != 0.0:
        x = (speed + root) / fall
    time = h - x
    return time if time > 0.0 and ((gap < 0.0 and x > 0.0) or (gap > 0.0 and speed < 0.0)) else math.inf


@kernel
def first_touch(ended, begun, active, joints, located, sizes, wide, geoms):
    """First time of impact of the located pairs in a move, and their least gap, for `nsdyn.stepping.substepping`.

    Parameters
    ----------
    ended : tuple
        Contacts at the end of the move, x and twists as in `touching.approach_of`, what moving surfaces add to their
        normal velocities, (nc,), and twists of the free acceleration.
    begun : tuple
        Of the contacts at the beginning (contacts, x, twists, what moving surfaces add).
    active : (keys, normal impulses)
    joints : (gaps, speeds where it ends, and where it begins)
        Of the located joint limits.
    located : ndarray of int
        Pairs of shapes.
    sizes : (closed, tol, θ, h)
    wide, geoms : float, int
        The gap returned if no contact is near, and the number of shapes.
    """
    (contacts, x, twists, carried, rates), (begin_contacts, begin_x, begin_twists, begin_carried) = ended, begun
    (names, _, scalars), (closed, tol, _, h) = contacts, sizes
    key, gap = names[4], scalars[0]
    place, pressed, time, least = np.empty(key.size, np.int64), np.empty(key.size, np.int64), math.inf, wide
    places(begin_contacts[0][4], key, place)
    places(active[0], key, pressed)
    for c in range(key.size):
        apart = True
        for code in located:
            apart = apart and code != names[0, c] * geoms + names[1, c]
        if apart or (pressed[c] >= 0 and active[1][pressed[c]] > 0.0):
            continue
        u, k = approach_of(c, contacts, x, twists) + carried[c], place[c]
        if abs(gap[c]) > closed or u < -tol:
            least = min(least, gap[c])
        if k < 0:
            change = h * approach_of(c, contacts, x, rates)
        else:
            change = u - (approach_of(k, begin_contacts, begin_x, begin_twists) + begin_carried[k])
        time = min(time, touch(gap[c], u, change, sizes))
    for k in range(joints[0].size):
        if abs(joints[0][k]) > closed or joints[1][k] < -tol:
            least = min(least, joints[0][k])
        time = min(time, touch(joints[0][k], joints[1][k], joints[1][k] - joints[2][k], sizes))
    return time, least
