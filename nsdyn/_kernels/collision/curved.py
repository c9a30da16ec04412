"""Contacts of ellipsoids and rims of cylinders: their normal is the direction of largest separation."""

import math

from nsdyn._kernels.collision.geometry import smaller, write
from nsdyn._kernels.collision.kinds import curvature, has_rim, opposite
from nsdyn._kernels.collision.segments import ANGLE
from nsdyn._kernels.collision.separation import INSIDE, SAME, SHARP, separation
from nsdyn._kernels.compiled import no_alloc
from nsdyn._kernels.vectors import along, axis, cross, dot, minus, perpendicular, row, square, times, unit

PROJECTIONS = 60
"""Most projections onto two disks in turns: enough for rims that cross at 0.5 rad."""


@no_alloc
def curvatures(geometry, k, m, e1, e2):
    """`curvature` of the support point of geom k in the direction m, for two tangents: (e1 e1, e1 e2, e2 e2)."""
    return curvature(geometry, k, m, e1, e1), curvature(geometry, k, m, e1, e2), curvature(geometry, k, m, e2, e2)


@no_alloc
def newton(geometry, i, j, m, axes, start, valid):
    """Newton step of m, along two tangents, towards stationary separation; `start` is a point of a `valid` segment."""
    e1, e2 = axes
    _, a, b = separation(geometry, i, j, m)
    bends = (0.0, 0.0, 0.0)
    if valid[0]:
        a = start
    else:
        bends = along(bends, 1.0, curvatures(geometry, i, m, e1, e2))
    if valid[1]:
        b = start
    else:
        bends = along(bends, 1.0, curvatures(geometry, j, times(-1.0, m), e1, e2))
    a11, a12, a22 = bends
    delta = minus(b, a)
    f1, f2, width, trace = dot(e1, delta), dot(e2, delta), dot(m, delta), a11 + a22
    # If the separation is not concave enough, step as if it were.
    if not (a11 + width > 0.0 and (a11 + width) * (a22 + width) - a12 * a12 > 1e-10 * trace * trace):
        width = abs(width) + 1e-5 * trace + INSIDE * smaller(geometry, i, j)
    a11, a22 = a11 + width, a22 + width
    det = a11 * a22 - a12 * a12
    return along(times((a22 * f1 - a12 * f2) / det, e1), (a11 * f2 - a12 * f1) / det, e2)


@no_alloc
def off_axis(geometry, i, j, n):
    """Return n, or beside it the axis of a disk, tilted a little towards the other geom.

    The outermost point of the disk jumps to its far side as n passes the axis, and no step leads across such a kink.
    """
    _, a, b = separation(geometry, i, j, n)
    for g, p, sign in ((i, b, 1.0), (j, a, -1.0)):
        z, d = axis(geometry.R, g), minus(p, row(geometry.t, g))
        if has_rim(geometry, g) and 1.0 - abs(dot(n, z)) < 0.5 * ANGLE * ANGLE:
            away, _ = unit(along(d, -dot(d, z), z))
            n, _ = unit(along(times(math.copysign(1.0, dot(n, z)), z), sign * SHARP, away))
    return n


@no_alloc
def between_disks(geometry, i, j, n):
    """Return the direction of largest separation of two disks that are almost across n; n if there are no two.

    With d from the centre of the first to that of the second, the gap along the direction n + τ is to first order

        d·n + d·τ - R1 ‖τ - τ1‖ - R2 ‖τ - τ2‖

    where the axes of the disks are n + τ1 and n + τ2. It is largest along an axis if the outermost point of the other
    disk is over the disk; else where the rims cross: R1 u1 + R2 u2 = d, for the unit vectors u1, u2 along τ - τ1 and
    τ - τ2.
    """
    if not (has_rim(geometry, i) and has_rim(geometry, j)):
        return n
    z1, z2 = axis(geometry.R, i), axis(geometry.R, j)
    z1, z2 = times(math.copysign(1.0, dot(n, z1)), z1), times(math.copysign(1.0, dot(n, z2)), z2)
    between, length = unit(minus(z2, z1))
    if max(1.0 - dot(n, z1), 1.0 - dot(n, z2)) > 0.5 * ANGLE * ANGLE:
        return n
    (r1, h1, _), (r2, h2, _) = row(geometry.size, i), row(geometry.size, j)
    d = along(along(minus(row(geometry.t, j), row(geometry.t, i)), -h1, z1), -h2, z2)
    x, far = unit(along(d, -dot(d, n), n))
    for z, end, most in ((z1, along(times(far, x), r2, between), r1), (z2, along(times(far, x), -r1, between), r2)):
        if length == 0.0 or dot(end, end) <= most * most:
            return z
    cosine = (far * far + r1 * r1 - r2 * r2) / (2.0 * far * r1)
    sine = math.sqrt(max(0.0, 1.0 - cosine * cosine))
    for side in (-sine, sine):
        u1 = along(times(cosine, x), side, cross(n, x))
        u2 = times(1.0 / r2, along(times(far, x), -r1, u1))
        turn = dot(n, cross(u1, u2))
        if dot(n, cross(between, u2)) * turn > 0.0 and dot(n, cross(between, u1)) * turn > 0.0:
            return unit(along(z1, length * dot(n, cross(between, u2)) / turn, u1))[0]
    return n


@no_alloc
def meeting(geometry, i, j, m, a, b):
    """Return the points of two geoms, as far along m as their support points a and b, that are opposite each other.

    Two disks may meet in the corner between their rims alone: the nearest points of each lead there, in turns.
    """
    for _ in range(PROJECTIONS):
        a = opposite(geometry, i, m, a, b, SHARP)
        b = opposite(geometry, j, times(-1.0, m), b, a, SHARP)
        d = minus(b, a)
        across = along(d, -dot(d, m), m)
        if dot(across, across) <= square(SAME * smaller(geometry, i, j)):
            break
    return a, b


@no_alloc
def smooth(geometry, i, j, n, lines, out, at):
    """Write the contact of two geoms, at least one of which is an ellipsoid or touches with the rim of a cylinder.

    The other geom may be a segment with a radius: `lines` has the result of `segment` for each geom. Newton's method,
    started at the given n, maximises the separation. At a stationary separation the support points a and b differ by a
    multiple of the normal.
    """
    size = smaller(geometry, i, j)
    (p1, q1, radius1, valid1), (p2, q2, radius2, valid2) = lines
    if valid1 and valid2:  # two segments: a geom with a rim touches with the rim instead
        valid1 = not has_rim(geometry, i)
        valid2 = not (has_rim(geometry, j) or valid1)
    start, end, radius, side = (p1, q1, radius1, 1.0) if valid1 else (p2, q2, radius2, -1.0)
    d, length = unit(minus(end, start))
    if not (valid1 or valid2):
        length = 0.0
    m, settled = between_disks(geometry, i, j, n), False
    if m == n:
        m = off_axis(geometry, i, j, n)
    for k in range(40):
        # On the way the lowest point of a rim may jump along an edge. What is round may begin far from its middle.
        if settled or (k == 0 and radius > 0.0):
            _, a, b = separation(geometry, i, j, m)
            s = dot(d, minus(b if valid1 else a, start))
            if length > 0.0 and not (s > 0.0 and s < length):  # the other geom is opposite an end of the segment
                start, length = end if s > 0.0 else start, 0.0
                # A segment whose ends are no balls touches with its rim.
                valid1, valid2 = valid1 and not has_rim(geometry, i), valid2 and not has_rim(geometry, j)
            elif settled:
                break
        if length > 0.0:  # rotate m about the line only
            m, _ = unit(along(m, -dot(m, d), d))
            e1, e2 = cross(d, m), (0.0, 0.0, 0.0)
        else:
            e1 = perpendicular(m)
            e2 = cross(m, e1)
        best, _, _ = separation(geometry, i, j, m)
        turn = newton(geometry, i, j, m, (e1, e2), start, (valid1, valid2))
        step, settled = math.sqrt(dot(turn, turn)), True
        tries = 10 if step >= 1e-15 else 0
        scale = min(1.0, 0.2 / step) if tries > 0 else 0.0
        for _ in range(tries):
            trial, _ = unit(along(m, scale, turn))
            value, _, _ = separation(geometry, i, j, trial)
            # Close to the maximum, round-off determines which value is larger.
            if step < 1e-7 or value > best:
                m, settled = trial, False
                break
            scale *= 0.5
    value, a, b = separation(geometry, i, j, m)
    given, _, _ = separation(geometry, i, j, n)
    if value < given - INSIDE * size:
        m = n
        value, a, b = separation(geometry, i, j, m)
    elif valid1 or valid2:
        # Any point of a segment is its support point: take the one opposite the other geom.
        s = min(max(dot(d, minus(b if valid1 else a, start)), 0.0), length)
        foot = along(along(start, s, d), side * radius, m)
        a, b = (foot, b) if valid1 else (a, foot)
    a, b = meeting(geometry, i, j, m, a, b)
    write(out, at, times(0.5, along(a, 1.0, b)), m, value)
