"""Persistent contacts of a move, and the couples with which they do no work."""

import math

import numpy as np

from nsdyn._kernels.compiled import kernel, no_alloc
from nsdyn._kernels.problem.blocks import relative_velocity
from nsdyn._kernels.reductions import copy
from nsdyn._kernels.stepping.law import NO_SLIP, OPEN, SLIP, STICK, state
from nsdyn._kernels.stepping.touching import last_status, places
from nsdyn._kernels.vectors import along, dot, put, row, square, times, to_local

STILL = 1e-3
"""Two thresholds. A closed contact neither approaches nor slips below this fraction of the change of velocity that
forces, and bodies that turn towards each other, make in a move. The rows of a contact at rest may drift by this
fraction of the gap tolerance."""

LEFT = 1e-8
"""Fraction of a relative velocity, and of the drift of its rows, that the solver's tolerance leaves as an error: bodies
that fall together, where forces change the relative velocity by no more than that, have no contact impulse."""

NO_ARM, NO_WORK, NOISE = 1e-10, 1e-13, 1e-10
"""Shifts of the force, as a fraction of R, below which bodies may be at rest and get no couple; works, as fractions of
r_N R ω, that are round-off; works that are round-off unless another pass halves them: impulses of redundant contacts
are less exact."""


@kernel
def persists(names, geoms, warm, begin, limits, local, end_gap, struck, out):
    """Persistent rows, into out = (stays, sticks, was): they do no work along (stays), across (sticks) their normals.

    A contact stays if it had an impulse in the last move. It also stays if it was closed where this move begins and did
    not approach. The same holds for joint limits, but open ones never stay. A contact does not stay if it overlaps (is
    squeezed), strikes or separates: an approach in h s faster than the drift of the rows is a motion of the bodies and
    no error. The drift is of first order, errors are of second; where no body turns there are none. Rows of a contact
    that strikes lose the drift of the bodies, which turn otherwise after the impact.

    A contact that stuck sticks however it approaches, because its slip is an error. A contact that stays and did not
    slip at the beginning sticks too. Gaps within the gap tolerance of rows that do not turn are set to 0. Returns
    whether any row stays.

    Parameters
    ----------
    names : ndarray of int, shape (5, nc)
    geoms : int
        Number of shapes.
    warm : tuple
        As in `last_status`.
    begin : tuple
        Contacts where the move begins; how much faster moving surfaces are at its end than at its midpoint, (3 rows,),
        m/s, empty if none move; and (gap tolerance, h, h₂).
    limits : tuple
        Gaps of joint rows, and whether they had an impulse, (rows - nc,) each.
    local, end_gap : ndarray, shapes (5, 3 rows), (rows,)
        Of `law.local_velocities`; changed in place.
    struck : bool
        Whether an impact acts in the move: then no row stays.
    out : tuple
        stays (rows,), sticks (nc,), and the states of the last move, was (nc,): slip for contacts that were closed
        without an impulse and slip now.
    """
    ((begin_names, _, scalars), quicker, (closed, h, ahead)), (stays, sticks, was), key = begin, out, names[4]
    begin_gap = scalars[0]
    some = False
    u_begin, u, u_free, jacobian_drift = local[0].copy(), local[1], local[2], local[3]
    for i in range(quicker.size):
        u_begin[i] -= quicker[i]
    before = np.empty(key.size, np.int64)
    places(begin_names[4], key, before)
    last_status(names, geoms, warm, was)
    nc = key.size
    for c in range(stays.size):
        i = 3 * c
        stays[c] = False
        if c < nc:
            sticks[c] = False
        if struck:
            continue
        if c < nc:
            known, gap, old = before[c] >= 0, begin_gap[before[c]] if before[c] >= 0 else 0.0, was[c]
        else:
            known, gap, old = True, limits[0][c - nc], SLIP if limits[1][c - nc] else OPEN
        speed = math.sqrt(square(u_begin[i]) + square(u_begin[i + 1]) + square(u_begin[i + 2]))
        bent = math.sqrt(square(jacobian_drift[i]) + square(jacobian_drift[i + 1]) + square(jacobian_drift[i + 2]))
        still = STILL * (abs(u_free[i] - u[i]) + max(0.0, -jacobian_drift[i])) - LEFT * (speed + bent)
        if c < nc and u_begin[i] < -(bent + closed / h):
            for j in range(i, i + 3):
                rest = quicker[j] if quicker.size > 0 else 0.0
                if j == i:
                    end_gap[c] += 0.5 * ahead * (jacobian_drift[j] - rest)
                jacobian_drift[j] = rest
        if gap < -2.0 * closed or (gap > closed and (c >= nc or old == OPEN)):
            continue
        if old == OPEN and (not known or abs(u_begin[i]) >= still):
            continue
        stays[c] = abs(u_begin[i]) <= bent + closed / h
        if c < nc:
            slip = math.sqrt(square(u_begin[i + 1]) + square(u_begin[i + 2]))
            sticks[c] = old == STICK or (stays[c] and old == OPEN and slip <= still)
            if old == OPEN and slip > max(still, NO_SLIP):
                was[c] = SLIP
        if stays[c] and abs(end_gap[c]) <= closed and abs(jacobian_drift[i]) * h <= STILL * closed:
            end_gap[c] = 0.0
        some = some or stays[c]
    return some


@no_alloc
def spin_of(f, free, R, v):
    """Angular velocity, world axes, of frame f, a free body; 0 for any other frame, taken to be fixed."""
    if f < 0 or f >= free:
        return 0.0, 0.0, 0.0
    i = 6 * f + 3
    w = v[i], v[i + 1], v[i + 2]
    return dot(row(R[f], 0), w), dot(row(R[f], 1), w), dot(row(R[f], 2), w)


@no_alloc
def add_couple(f, sign, couple, R, inverse_J, dv):
    """Add to dv the change of velocity of frame f by `sign` times a couple in world axes; none for the world (-1)."""
    if f >= 0:
        own = to_local(R, f, couple)
        for i in range(3):
            for j in range(3):
                dv[6 * f + 3 + i] += sign * inverse_J[f, i, j] * own[j]


@no_alloc
def holds(i, r, y, mu):
    """Whether the contact with the rows from i on does not slip, at r and y = W r + b."""
    if state(r, mu, i) == STICK:
        return True
    # Of redundant contacts that share an impulse some may be at the friction limit without slip.
    return math.sqrt(square(y[i + 1]) + square(y[i + 2])) <= LEFT


@kernel
def couples(blocks, contacts, mean, bodies, pressed, flags, found):
    """Couples with which persistent contacts of free bodies do no work, and the change of v by the couples.

    w = Σ r·ū is the work of the contacts of a pair of shapes: normal work, and tangential work of those that stick. ω̄
    is the angular velocity of body 2 relative to body 1. The couple on body 2 is -w ω̄/‖ω̄‖², on body 1 the opposite,
    as if the contact forces acted at shifted points, by at most h ‖ω̄‖ R, the way of body points. If no contact sticks,
    ω̄ is taken perpendicular to the normal, because a normal force has no moment about it. Contacts share the couple in
    proportion to their normal impulses. Velocities are relative to moving surfaces, whose own work is booked
    separately.

    Parameters
    ----------
    blocks : tuple
        Factors of W.
    contacts : (names, points, scalars)
    mean : ndarray, shape (n,)
        Mean v̄ of the velocities before and after the impulses r (3 rows,).
    bodies : tuple
        R, inverse_J, shapes (frames, 3, 3), (nf, 3, 3); how far bodies reach from their centres, (frames,), m; and h.
    pressed : tuple
        r, y = W r + b and mu, shapes (3 rows,), (3 rows,) and (rows,); what moving surfaces add to u, (3 rows,), empty
        if none move; and the errors of relative velocities that the solver leaves, (nc,), m/s, whose work is not
        corrected.
    flags : three ndarrays of bool, shape (nc,)
        Contacts that stay, stick, and slide through.
    found : tuple
        couple, shape (nc, 3), on body 2, world axes, N·m·s: the couples so far, replaced where the work is not 0; dv,
        shape (n,), the change of v by the couples; left, shape (nc,), the work that the couples of the pair leave, J,
        on entry that of the pass before, infinite if there was none or its gaps were different; other, shape (nc,),
        whether the new couples differ from those so far by more than round-off: the result is whether any does.
    """
    names, normal = contacts[0], contacts[1][1]
    geom1, geom2, frame1, frame2 = names[0], names[1], names[2], names[3]
    (R, inverse_J, arm, h), (r, y, mu, surface_velocity, exact) = bodies, pressed
    couple, dv, left, other = found
    stays, sticks, sliding = flags
    free, nc, some = inverse_J.shape[0], geom1.size, False
    u = np.empty(r.size)
    relative_velocity(blocks, mean, u)
    for i in range(surface_velocity.size):
        u[i] += surface_velocity[i]
    dv[:] = 0.0
    other[:] = False
    first = 0
    while first < nc:
        last, work, joint_load, held, before = first, 0.0, 0.0, False, 0.0
        while last < nc and geom1[last] == geom1[first] and geom2[last] == geom2[first]:
            i, before = 3 * last, max(before, left[last])
            if stays[last] and r[i] > 0.0:
                joint_load += r[i]
                work += r[i] * u[i]
                if sticks[last] and not sliding[last] and holds(i, r, y, mu[last]):
                    work += r[i + 1] * u[i + 1] + r[i + 2] * u[i + 2]
                    held = True
            last += 1
        a, b, most, size, turning = frame1[first], frame2[first], 0.0, 0.0, (0.0, 0.0, 0.0)
        if joint_load > 0.0 and a < free and b < free:
            size = max(arm[a] if a >= 0 else 0.0, arm[b] if b >= 0 else 0.0)
            turning = along(spin_of(b, free, R, mean), -1.0, spin_of(a, free, R, mean))
            if not held:
                turning = along(turning, -dot(row(normal, first), turning), row(normal, first))
            most = joint_load * h * math.sqrt(dot(turning, turning)) * size
        if most > NO_ARM * joint_load * size:
            speed = math.sqrt(dot(turning, turning))
            amount = min(max(-work / speed, -most), most)
            now = 0.0
            for c in range(first, last):
                now += dot(row(couple, c), turning)
            rest, scale = abs(amount * speed - now), joint_load * size * speed
            left_over = max(joint_load * exact[first], NO_WORK * scale)
            differ = rest > left_over and (rest > NOISE * scale or rest < 0.5 * before)
            left[first:last] = rest
            some = some or differ
            total = (0.0, 0.0, 0.0)
            for c in range(first, last):
                if differ:
                    share = r[3 * c] / joint_load if stays[c] and r[3 * c] > 0.0 else 0.0
                    put(couple, c, times(share * amount / speed, turning))
                other[c] = differ
                total = along(total, 1.0, row(couple, c))
            add_couple(a, -1.0, total, R, inverse_J, dv)
            add_couple(b, 1.0, total, R, inverse_J, dv)
        else:
            for c in range(first, last):
                other[c] = dot(row(couple, c), row(couple, c)) > 0.0
                some = some or other[c]
                put(couple, c, (0.0, 0.0, 0.0))
        first = last
    return some


@no_alloc
def turns(v, free, h):
    """Whether any free body may turn relative to another far enough in h s for a couple."""
    most = 0.0
    for f in range(free):
        most = max(most, square(v[6 * f + 3]) + square(v[6 * f + 4]) + square(v[6 * f + 5]))
    return 2.0 * h * math.sqrt(most) > NO_ARM


@kernel
def turn(blocks, contacts, mean, bodies, pressed, flags, found):
    """Replace the couples so far by `couples` if any contact then does less work; return whether they changed."""
    couple, dv, left, other = found
    other[:] = False
    if not turns(mean, bodies[1].shape[0], bodies[3]):
        return False
    turned, acting = couple.copy(), dv.copy()
    if not couples(blocks, contacts, mean, bodies, pressed, flags, (turned, acting, left, other)):
        return False
    copy(acting, dv)
    for c in range(couple.shape[0]):
        copy(turned[c], couple[c])
    return True


@kernel
def works(names, free, R, mean, couple, out):
    """Works of couples at the mean velocity, into out (nc,), J."""
    for c in range(out.size):
        turning = along(spin_of(names[3, c], free, R, mean), -1.0, spin_of(names[2, c], free, R, mean))
        out[c] = dot(row(couple, c), turning)
