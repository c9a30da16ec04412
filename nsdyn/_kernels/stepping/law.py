"""The contact law of a step: relative velocities and their offsets, prediction of sliding, works.

The contacts come first with three rows each (N, T1, T2), then joint limits and joint friction. Names are those of
`nsdyn.stepping.contact_kinematics`. "Foreseen" means predicted from the motion up to the midpoint.
"""

import math

import numpy as np

from nsdyn._kernels.compiled import kernel, no_alloc
from nsdyn._kernels.dynamics.motion import beyond_potential
from nsdyn._kernels.problem.blocks import dependent, diagonal_block, relative_velocity, widest
from nsdyn._kernels.stepping.options import OPTIONS
from nsdyn._kernels.stepping.touching import places, turns_far
from nsdyn._kernels.vectors import along, cross, dot, minus, row, square

TILT = OPTIONS.tilt

OPEN, STICK, SLIP, JAM = range(4)
"""States of contacts: without impulse; with an impulse inside the cone, and on its boundary; and jammed."""

SWING = 3.0
"""Largest turn of a normal over the turns of the bodies, plus their way over the smaller inscribed radius of the curved
ones: a normal that turns more has jumped to another feature. Crossing edges and the rim of an ellipsoid turn it faster
than bodies turn."""

TOGETHER = 0.01
"""Square of the distance of two contacts that roll as one, over the square of the way that they go."""

NO_SLIP = 1e-14
"""Slip, m/s, that is round-off: a body at rest with its impulse on the edge of the cone keeps slipping by less."""

REVERSED = 1e-8
"""Mean slip over the slip at the end that is none: the tolerance of solvers."""

LEFT, MOST_LEFT = 1.0 / 9.0, 0.5
"""Fraction of a gap that `left_open` leaves open, and the largest gap it leaves, as a fraction of the gap tolerance."""


@no_alloc
def warm_start(place, force, h, frame, r):
    """Warm start: impulses in h s of the world forces of old contacts, in the frames of the new ones, into r (3 nc,).

    place (nc,) is the index of each contact among the old ones; new contacts (-1) get 0.
    """
    for c in range(place.size):
        for i in range(3):
            r[3 * c + i] = 0.0
            if place[c] >= 0:
                p = force[place[c]]
                r[3 * c + i] = h * (frame[c, i, 0] * p[0] + frame[c, i, 1] * p[1] + frame[c, i, 2] * p[2])


@no_alloc
def alone(k, contacts, near, closed):
    """Whether no other contact of the frames of contact k is as deep, to within `closed`; those within √near are it."""
    names, points, scalars = contacts
    for other in range(names.shape[1]):
        if names[2, other] == names[2, k] and names[3, other] == names[3, k]:
            d = minus(row(points[0], other), row(points[0], k))
            if scalars[0, other] <= scalars[0, k] + closed and dot(d, d) > near:
                return False
    return True


@no_alloc
def begin_velocities(place, begin, here, carried, surface_velocity, ahead, u, far):
    """Relative velocities of the contacts at the beginning of the step, with the rows of the beginning, into u (3 nc,).

    Mark also the contacts that turn far, in `far` (nc,).

    Frame f moves at the beginning with linear[f] + angular[f] x (p - x_old[f]). A contact may have been found at the
    beginning too, at a point from which the motion may have carried it to the midpoint. It then uses that point and
    that normal; its tangents are those of the midpoint turned by the least rotation from normal to normal. Any other
    contact uses the arms and the frame of the midpoint.

    The only contact of two frames may have moved any distance, because it may roll: the contact of a disk which lies
    almost flat moves round the rim a hundred times as fast as the points of the disk. A point near enough to touch
    within a move is a contact of its own from the start. One of several contacts, here or at the beginning, moves at
    most as far as the bodies do: where an edge slides across another nothing rolls, nor where a disk falls flat. Those
    that are much closer together than that, as on both rims of a coin, count as one.

    Bodies turn no further up to the midpoint than in the `ahead` s after it. Moving surfaces add `carried` (old
    contacts, 3) at the beginning, in world axes, and `surface_velocity` (3 nc,) at the midpoint, in the contact
    frames; both are empty without moving surfaces. `begin` and `here` are as in `local_velocities`.
    """
    (_, old_points, _), x_old, (linear, angular), (reach, closed, rounding, _) = begin
    (names, points, _), frame, x = here
    for c in range(place.size):
        f1, f2, n = names[2, c], names[3, c], row(frame[c], 0)
        p, k = row(points[0], c), place[c]
        m, there = n, False
        if k >= 0:
            d, m = minus(p, row(old_points[0], k)), row(old_points[1], k)
            way, turn, tilt = 0.0, 0.0, minus(n, m)
            for f in (f1, f2):
                if f >= 0:
                    way += reach[f]
                    turn += ahead * math.sqrt(dot(row(angular, f), row(angular, f)))
                elif carried.size:  # it may be driven
                    turn = math.inf
            turn += way / min(rounding[names[0, c]], rounding[names[1, c]])
            most, gone, way = min(TILT, SWING * turn), dot(d, d), way * way
            near = TOGETHER * gone
            there = dot(tilt, tilt) <= most * most and (
                gone <= way or (alone(k, begin[0], near, closed) and alone(c, here[0], near, closed))
            )
        far[c] = turns_far(c, k if there else -1, begin, here, ahead)
        w = (0.0, 0.0, 0.0)
        for s in range(2):
            f = f1 if s == 0 else f2
            if f >= 0:
                arm = minus(row(old_points[0], k), row(x_old, f)) if there else minus(p, row(x, f))
                w = along(w, -1.0 if s == 0 else 1.0, along(row(linear, f), 1.0, cross(row(angular, f), arm)))
        if there and carried.size:
            w = along(w, 1.0, row(carried, k))
        if there:  # turned back by the rotation from n to m
            total = along(n, 1.0, m)
            w = along(along(w, -dot(total, w) / (1.0 + dot(n, m)), total), 2.0 * dot(m, w), n)
        for i in range(3):
            u[3 * c + i] = dot(row(frame[c], i), w)
            if not there and surface_velocity.size:
                u[3 * c + i] += surface_velocity[3 * c + i]


@no_alloc
def local_velocities(blocks, velocities, surfaces, begin, here, warm, ahead, out):
    """Relative velocities of a step, their drift in its second half, gaps at its end for zero normal speed; warm start.

    u_begin is v_begin in the rows of the beginning; u and u_free are in the rows of the midpoint. `jacobian_drift`
    = u - u_begin is the change of relative velocity because the rows turn, without any impulse. end_gap
    = gap - ahead/2 drift_N belongs to the parabola whose speed at the end of the step, `ahead` seconds later, is 0,
    but for changes of the twists. For contacts that turn far no drift is foreseen.

    Parameters
    ----------
    blocks : tuple
        Factors of W.
    velocities : tuple
        v_begin, v, v_free.
    surfaces : tuple
        Velocities that moving surfaces add: `carried` and `surface_velocity` as in `begin_velocities`, both with the
        twists of the midpoint; the surface velocity with the twists of the end; normal velocities of joint friction.
        Each is empty for none.
    begin : tuple
        The contacts found at the beginning of the step, places and twists of the frames there, and (how far points of
        the frames move in about half a step, the gap tolerance, inscribed radii of curved shapes, infinite for others,
        how many frames are free bodies).
    here : tuple
        The contacts at the midpoint, their directions, and the places of the frames.
    warm : tuple
        Keys, forces in world axes, h: forces whose impulses in h s start the solver. Their contacts need not be those
        found at the beginning of the step.
    ahead : float
    out : tuple
        local, shape (5, 3 rows): u_begin, u, u_free, drift, warm start; end_gap, shape (rows,); the places of the
        contacts among those of `warm`, shape (nc,); and the contacts that turn far, shape (nc,).
    """
    local, end_gap, place, far = out
    v_begin, v, v_free = velocities
    carried, surface_velocity, transport_end, joint_load = surfaces
    (names, _, scalars), frame, _ = here
    key, nc = names[4], names.shape[1]
    u_begin, u, u_free, jacobian_drift, guess = local[0], local[1], local[2], local[3], local[4]
    relative_velocity(blocks, v, u)
    relative_velocity(blocks, v_free, u_free)
    if u.size > 3 * nc:  # joint rows are the same everywhere
        relative_velocity(blocks, v_begin, u_begin)
    places(begin[0][0][4], key, place)
    begin_velocities(place, begin, here, carried, surface_velocity, ahead, u_begin, far)
    places(warm[0], key, place)
    warm_start(place, warm[1], warm[2], frame, guess)
    for i in range(surface_velocity.size):
        u[i] += surface_velocity[i]
        u_free[i] += surface_velocity[i]
    for i in range(u.size):
        jacobian_drift[i] = u[i] - u_begin[i]
    for c in range(nc):
        if far[c]:
            jacobian_drift[3 * c], jacobian_drift[3 * c + 1], jacobian_drift[3 * c + 2] = 0.0, 0.0, 0.0
        end_gap[c] = scalars[0, c] - 0.5 * ahead * jacobian_drift[3 * c]
    # Kinematic bodies have the twist of the end from the midpoint on; reaching it takes no time.
    for i in range(surface_velocity.size):
        jacobian_drift[i] += transport_end[i] - surface_velocity[i]
    for i in range(joint_load.size):
        u_free[i] += joint_load[i]


@kernel
def predict_sliding(blocks, mu, place, old_status, local, sliding):
    """Predict which contacts slide through the step, too fast for the foreseen friction to stop, into sliding (nc,).

    Only contacts that slid in the last move can. One that stuck begins without slip, except for errors of the solver's
    tolerance; for a new one nothing can be foreseen. `local` is the result of `local_velocities`.
    """
    u_begin, u_free, jacobian_drift, guess, most = local[0], local[2], local[3], local[4], widest(blocks[0])
    x, y, W = np.empty((3, most)), np.empty((3, most)), np.empty((3, 3))
    for c in range(sliding.size):
        i = 3 * c
        sliding[c] = False
        if place[c] < 0 or old_status[place[c]] != 2:
            continue
        slip = math.sqrt(square(u_begin[i + 1]) + square(u_begin[i + 2]))
        if slip <= 2.0 * math.sqrt(square(jacobian_drift[i + 1]) + square(jacobian_drift[i + 2])) or mu[c] == 0.0:
            continue
        diagonal_block(blocks, c, 3, x, y, W)
        joint_load = max(0.0, -(u_free[i] + jacobian_drift[i])) / W[0, 0] if W[0, 0] > 0.0 else 0.0
        sliding[c] = slip > mu[c] * max(joint_load, guess[i]) * (W[1, 1] + W[2, 2])


@no_alloc
def left_open(gap, u, ahead, closed):
    """Return the gap, m, with which a persistent contact is to end a move.

    `gap` is G, the gap at the end with zero normal speed, and u the normal speed at the beginning. If all moves ended
    with gap 0, normal speeds would alternate in sign: the contact forces would keep an alternation for good once it
    arose, at a landing say. In smooth motion G + h₂ u is 0. Otherwise the move leaves 1/9 of G + h₂ u open, which then
    falls to a third with each move.
    """
    return min(max(LEFT * (gap + ahead * u), -MOST_LEFT * closed), MOST_LEFT * closed)


@no_alloc
def off(gap, r, stays, closed, out):
    """Persistent rows with an impulse whose gap (rows,) is not 0 at the end of a move, into out (rows,); if any.

    `closed` (rows,) are gaps that count as none.
    """
    some = False
    for c in range(out.size):
        out[c] = stays[c] and r[3 * c] > 0.0 and abs(gap[c]) > MOST_LEFT * closed[c]
        some = some or out[c]
    return some


@kernel
def end_otherwise(off, gap, key, ended, local, sizes, end_gap, excess_speed):
    """Correct G and `excess_speed` (rows,) of rows that are `off` (rows,): rows with other end gaps than intended.

    `gap` (rows,) are the gaps at the end of the move, ended = (keys, normal speeds, speeds of joint rows) the contacts
    found there, `key` (nc,) those of the move. `excess_speed` is how much faster than foreseen they separate, m/s.
    sizes = (h₂, gap tolerances (rows,)). A row is not `off` if its gap is within `MOST_LEFT` of them of that intended.
    Nor is it if its gap is larger than the drift of the rows or the excess speed can open: the gap then belongs to
    another contact, which detection gave the key of one that moved far. Returns whether any row is off.
    """
    ahead, closed = sizes
    nc, some = key.size, False
    place = np.empty(nc, np.int64)
    places(ended[0], key, place)
    for c in range(off.size):
        if off[c]:
            i = 3 * c
            left = left_open(end_gap[c], local[0, i] - excess_speed[c], ahead, closed[c])
            foreseen = (left - end_gap[c]) / ahead
            if c >= nc:
                more = ended[2][c - nc] - foreseen
            elif place[c] >= 0:
                more = ended[1][place[c]] - foreseen
            else:  # the contact rolls away: no gap is left open
                more = local[0, i] + end_gap[c] / ahead
            bent = math.sqrt(square(local[3, i]) + square(local[3, i + 1]) + square(local[3, i + 2]))
            off[c] = MOST_LEFT * closed[c] < abs(gap[c] - left) <= ahead * max(bent, abs(more))
            if off[c]:
                end_gap[c] += gap[c] - left
                excess_speed[c], some = more, True
    return some


@no_alloc
def offsets(local, laws, stays, sliding, b):
    """Velocities b without impulses for which y = W r + b obeys the contact law, into b (3 rows,).

    Normal: u_free + drift, plus the speed at which an open gap closes. Where a row `stays` (rows,; empty for none) its
    gap closes with either sign, except for the part `left_open`. Tangential: u_free + drift for slip at the end of the
    step; u + u_free, twice the mean slip without impulses, where a contact slides through. A contact that separates at
    u - drift and gets an impulse nevertheless comes back no faster than it separated: its normal impulse does no
    positive work. Where it was `struck` (rows,; empty for none) it does not come back.

    `local` is the result of `local_velocities`. laws = (end_gap, restitution, struck, excess_speed, rule) with
    `excess_speed` of `ContactKinematics` and rule = (closed, shallow, ahead, until) as in `GapRule`: gaps up to
    `closed` count as none; gaps up to `shallow` close when the next impulses act, `until` seconds later; larger ones,
    and those that may rebound, close within the step.
    """
    u, u_free, jacobian_drift = local[1], local[2], local[3]
    end_gap, restitution, struck, excess_speed, (closed, shallow, ahead, until) = laws
    for c in range(end_gap.size):
        i = 3 * c
        b[i] = u_free[i] + jacobian_drift[i]
        soon = abs(end_gap[c]) > shallow or restitution[c] > 0.0
        if stays.size > c and stays[c]:
            gap = end_gap[c] - (left_open(end_gap[c], local[0, i] - excess_speed[c], ahead, closed) if soon else 0.0)
        else:
            gap = end_gap[c] if end_gap[c] > closed else 0.0
        close, part = gap / (ahead if soon else until), u[i] - jacobian_drift[i]
        returns = not ((stays.size > c and stays[c]) or (struck.size > c and struck[c]))
        b[i] += max(close, part) if returns and ahead * part > closed else close
        if sliding.size > c and sliding[c]:
            b[i + 1], b[i + 2] = u[i + 1] + u_free[i + 1], u[i + 2] + u_free[i + 2]
        else:
            b[i + 1], b[i + 2] = u_free[i + 1] + jacobian_drift[i + 1], u_free[i + 2] + jacobian_drift[i + 2]


@no_alloc
def reconsider(solution, local, sliding, back):
    """Correct `sliding` (nc,) by the solution (r, y, b, mu), y = W r + b; return whether any contact changed.

    A contact predicted to slide through has stopped if it sticks, or if its mean slip opposes its slip at the end or is
    round-off of it: a force on the edge of its cone would reverse the slip. A contact predicted to stop slides through
    if it still slips in its first direction; with `back` this is not checked.
    """
    (r, y, b, mu), (u_begin, u, u_free, jacobian_drift) = solution, (local[0], local[1], local[2], local[3])
    some = False
    for c in range(sliding.size):
        i = 3 * c
        found = state(r, mu[c], i)
        # The relative velocities after the impulses, and at the end.
        p, q = y[i + 1] - b[i + 1] + u_free[i + 1], y[i + 2] - b[i + 2] + u_free[i + 2]
        e, f = p + jacobian_drift[i + 1], q + jacobian_drift[i + 2]
        if sliding[c]:
            mean = (u[i + 1] + p) * e + (u[i + 2] + q) * f
            if found == STICK or (found == SLIP and mean <= REVERSED * (e * e + f * f)):
                sliding[c] = False
                some = True
        elif found == SLIP and not back and mu[c] > 0.0 and u_begin[i + 1] * e + u_begin[i + 2] * f > NO_SLIP * NO_SLIP:
            sliding[c] = True
            some = True
    return some


@no_alloc
def state(r, mu, i):
    """State of rows i to i + 2: `OPEN`, `STICK` or `SLIP`."""
    if r[i] <= 0.0:
        return OPEN
    return STICK if math.sqrt(square(r[i + 1]) + square(r[i + 2])) < mu * r[i] * (1.0 - 1e-9) else SLIP


@no_alloc
def states(r, mu, out):
    """`state` of every contact, into out (nc,)."""
    for c in range(out.size):
        out[c] = state(r, mu[c], 3 * c)


@no_alloc
def contact_works(bodies, move, velocities, rows, r, lasting, slow, out):
    """Results of a step at its contacts and joint rows: states, works [J], relative velocities, forces in world axes.

    They go into out = (status, normal, friction, u_end, world). lasting = (stays, sticks, works of couples, as in
    `persistence`, normal impulses of impacts), the latter two empty for none. rows = (factors of W, velocities of
    moving surfaces, mu, the result of `local_velocities`, directions of the contacts). States are those of `states`,
    but a contact that slips no faster than `slow` at the end sticks, and where its rows are `dependent` no faster than
    its gap is corrected: impulses of redundant contacts or rows may lie anywhere in their cones. The works (rows,) are
    ½ (u + u⁺)·r, those of the impulses at the one configuration where they act.

    Returns `beyond_potential` of bodies = (mass, gravity) in a move = (h, theta), and three sums of works: normal,
    friction, and works that vanish in the limit of small steps. The last has the normal work, with that of the couple,
    of rows that stay closed and of rows that were struck, and the tangential work of contacts that stick.
    """
    blocks, surface_velocity, mu, local, frame = rows
    stays, sticks, turned, struck = lasting
    u, jacobian_drift, (h, _) = local[1], local[3], move
    status, normal, friction, u_end, world = out
    nc = status.size
    relative_velocity(blocks, velocities[2], u_end)
    for i in range(surface_velocity.size):
        u_end[i] += surface_velocity[i]
    impact, rubbed, rest = 0.0, 0.0, 0.0
    for c in range(normal.size):
        i = 3 * c
        # So far u_end is u⁺.
        normal[c] = 0.5 * (u[i] + u_end[i]) * r[i]
        friction[c] = 0.5 * ((u[i + 1] + u_end[i + 1]) * r[i + 1] + (u[i + 2] + u_end[i + 2]) * r[i + 2])
        for j in range(3):
            u_end[i + j] += jacobian_drift[i + j]
        nothing, held = stays[c], False
        if c < nc:
            status[c], slip = state(r, mu[c], i), square(u_end[i + 1]) + square(u_end[i + 2])
            if status[c] == SLIP and mu[c] > 0.0:
                if slip <= slow * slow or (stays[c] and slip <= square(u_end[i]) and dependent(blocks, c)):
                    status[c] = STICK
            if turned.size > c:
                normal[c] += turned[c]
            held = sticks[c] and status[c] == STICK
            for j in range(3):
                world[c, j] = (frame[c, 0, j] * r[i] + frame[c, 1, j] * r[i + 1] + frame[c, 2, j] * r[i + 2]) / h
        if nothing or (struck.size > c and struck[c] > 0.0):
            rest += normal[c]
        else:
            impact += normal[c]
        if held:
            rest += friction[c]
        else:
            rubbed += friction[c]
    return beyond_potential(*bodies, *move, *velocities), impact, rubbed, rest
