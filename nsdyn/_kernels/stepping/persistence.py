"""Contacts that persist through a move, and the couples that make them do no work."""

import math

import numpy as np

from nsdyn._kernels.compiled import kernel, no_alloc
from nsdyn._kernels.problem.blocks import relative_velocity
from nsdyn._kernels.reductions import copy
from nsdyn._kernels.stepping.law import NO_SLIP
from nsdyn._kernels.stepping.touching import last_status, places
from nsdyn._kernels.vectors import along, dot, put, row, square, times, to_local

STILL = 1e-3
"""Fraction of what forces, and bodies that turn towards each other, change a velocity by in a move below which a closed
contact neither approaches nor slips; and of what counts as closed, by which the rows of a contact at rest may drift."""

LEFT = 1e-8
"""What the solver's tolerance leaves of a relative velocity, and of what its rows turn by: bodies that fall together,
on which forces change no more, do not press."""

JOLT = 1.0
"""Speeds of approach that are errors of a motion, in drifts of the rows over half a move: these are of first order,
errors of second. Where nothing turns there are none, and what approaches is stopped."""

ARM = 1.0
"""Most that a couple moves a contact force, in lengths h ω R: as far as points of the body go in the move."""

NO_ARM, NO_WORK, NOISE = 1e-10, 1e-13, 1e-10
"""Arms, as fractions of R, of what may be at rest, which have no couples; works, of r_N R ω, that are round-off;
and those that are if another pass does not halve them: impulses of redundant contacts are less exact."""


@kernel
def persists(names, geoms, warm, begin, limits, local, end_gap, struck, out):
    """Which rows persist, into out = (stays, sticks, was): those that do no work along and across their normals.

    What pressed in the last move, by `warm` as of `last_status`, or was closed where this one begins, by begin = (the
    contacts, what counts as closed, h), and did not approach, stays, as do joint limits, of which `limits` has
    (gaps, whether they pressed), (rows - nc,) each. Not what is squeezed, so that it overlaps, strikes or parts: an
    approach in h s faster than `JOLT` drifts of the rows is one of the bodies, and no error. What stuck sticks however
    it approaches, for its slip is an error, as does what stays and did not slip there. Gaps that count as closed, of
    rows that do not turn, are set to 0. Returns whether anything stays. What contacts were in the last move goes into
    was (nc,), slip if they were closed without pressing, and slip now.
    """
    ((begin_names, _, scalars), closed, h), (stays, sticks, was), key = begin, out, names[4]
    begin_gap = scalars[0]
    some = False
    u_begin, u, u_free, jacobian_drift = local[0], local[1], local[2], local[3]
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
            known, gap, old = True, limits[0][c - nc], 2 if limits[1][c - nc] else 0
        speed = math.sqrt(square(u_begin[i]) + square(u_begin[i + 1]) + square(u_begin[i + 2]))
        bent = math.sqrt(square(jacobian_drift[i]) + square(jacobian_drift[i + 1]) + square(jacobian_drift[i + 2]))
        still = STILL * (abs(u_free[i] - u[i]) + max(0.0, -jacobian_drift[i])) - LEFT * (speed + bent)
        if gap < -2.0 * closed or (old == 0 and (not known or gap > closed or abs(u_begin[i]) >= still)):
            continue
        stays[c] = abs(u_begin[i]) <= JOLT * bent + closed / h
        if c < nc:
            slip = math.sqrt(square(u_begin[i + 1]) + square(u_begin[i + 2]))
            sticks[c] = old == 1 or (stays[c] and old == 0 and slip <= still)
            if old == 0 and slip > max(still, NO_SLIP):
                was[c] = 2
        if stays[c] and abs(end_gap[c]) <= closed and abs(jacobian_drift[i]) * h <= STILL * closed:
            end_gap[c] = 0.0
        some = some or stays[c]
    return some


@no_alloc
def spin_of(f, free, R, v):
    """Angular velocity of frame f, that of a free body or of one that stands still, world axes."""
    if f < 0 or f >= free:
        return 0.0, 0.0, 0.0
    i = 6 * f + 3
    w = v[i], v[i + 1], v[i + 2]
    return dot(row(R[f], 0), w), dot(row(R[f], 1), w), dot(row(R[f], 2), w)


@no_alloc
def add_couple(f, sign, couple, R, inverse_J, dv):
    """Add to dv what a couple in world axes does to frame f, unless that stands still."""
    if f >= 0:
        own = to_local(R, f, couple)
        for i in range(3):
            for j in range(3):
                dv[6 * f + 3 + i] += sign * inverse_J[f, i, j] * own[j]


@no_alloc
def holds(i, r, y, mu):
    """Whether the contact of the rows from i on does not slip, at r and y = W r + b."""
    if math.sqrt(square(r[i + 1]) + square(r[i + 2])) < mu * r[i] * (1.0 - 1e-9):
        return True
    # Of what redundant contacts share some may be at its limit all the same.
    return math.sqrt(square(y[i + 1]) + square(y[i + 2])) <= LEFT


@kernel
def couples(blocks, contacts, mean, bodies, pressed, flags, found):
    """Couples that make contacts of free bodies that persist do no work, and the change of v by them.

    With w = Σ r·ū of the contacts of a pair of shapes, normal and, of those that stick, tangential, and ω̄ how body 2
    turns on body 1, the pair turns by -w ω̄/‖ω̄‖² and back: as if its forces pressed a little elsewhere, at most by
    `ARM` h ‖ω̄‖ R. Where nothing sticks only across the normal, about which a normal force has no moment. Contacts carry
    it in the ratio of their pressures. Velocities are relative to surfaces that move: the work of these is their own.

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
        r, y = W r + b and mu, shapes (3 rows,), (3 rows,) and (rows,), what moving surfaces add to u, (3 rows,), empty
        if none move, and what the solver leaves of a relative velocity, m/s: works of that are no works.
    flags : three ndarrays of bool, shape (nc,)
        Contacts that stay, stick, and slide through.
    found : tuple
        couple, shape (nc, 3), on body 2, world axes, N·m·s: those that act, changed where others would do no work; dv,
        shape (n,), the change of v by them; left, shape (nc,), the work that the couples of the pair leave, J, changed
        from that of those before, infinite if none was looked for, or gaps were others then; other, shape (nc,),
        whether they differ from those that act by more than round-off.

    Returns
    -------
    bool
        Whether any does.
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
            most = ARM * joint_load * h * math.sqrt(dot(turning, turning)) * size
        if most > NO_ARM * joint_load * size:
            speed = math.sqrt(dot(turning, turning))
            amount = min(max(-work / speed, -most), most)
            now = 0.0
            for c in range(first, last):
                now += dot(row(couple, c), turning)
            rest, scale = abs(amount * speed - now), joint_load * size * speed
            differ = rest > joint_load * exact and (rest > NOISE * scale or NO_WORK * scale < rest < 0.5 * before)
            left[first:last] = rest
            some = some or differ
            for c in range(first, last):
                if differ:
                    share = r[3 * c] / joint_load if stays[c] and r[3 * c] > 0.0 else 0.0
                    put(couple, c, times(share * amount / speed, turning))
                other[c] = differ
            total = (0.0, 0.0, 0.0)
            for c in range(first, last):
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
    """Whether any of the free bodies may turn on another by so much in h s that they have couples."""
    most = 0.0
    for f in range(free):
        most = max(most, square(v[6 * f + 3]) + square(v[6 * f + 4]) + square(v[6 * f + 5]))
    return 2.0 * h * math.sqrt(most) > NO_ARM


@kernel
def turn(blocks, contacts, mean, bodies, pressed, flags, found):
    """`couples` in place of those that act, where others do less work; whether any do."""
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
