"""Shapes along a direction: what is outermost, how far two are apart, how they curve there.

R (n, 3, 3) and t (n, 3) are the poses of all geoms.
"""

import math

from nsdyn._kernels.collision.geometry import CAPSULE, CYLINDER, ELLIPSOID, HALFSPACE, SPHERE
from nsdyn._kernels.compiled import in_place
from nsdyn._kernels.vectors import along, axis, cross, dot, minus, row, times, to_local, to_world, unit

SHARP = 1e-6  # rad; the same for corners and edges beside such a face
SAME = 1e-6  # points closer than this fraction of the size are one
INSIDE = 1e-9  # a point this fraction of the size outside a side plane is on it


@in_place(forceinline=True)
def deepest_vertex(geometry, g, n):
    """Row of the vertex of polytope g farthest along n (shape frame)."""
    best, k = -math.inf, -1
    for i in range(geometry.vertex_ptr[g], geometry.vertex_ptr[g + 1]):
        h = dot(row(geometry.vertices, i), n)
        if h > best:
            best, k = h, i
    return k


@in_place
def on_ellipsoid(s, n):
    """Point of the ellipsoid of radii s with the outward normal n, and the height of its tangent plane."""
    height = math.sqrt((s[0] * n[0]) ** 2 + (s[1] * n[1]) ** 2 + (s[2] * n[2]) ** 2)
    return (s[0] ** 2 * n[0] / height, s[1] ** 2 * n[1] / height, s[2] ** 2 * n[2] / height), height


@in_place(forceinline=True)
def support(geometry, g, R, t, n):
    """A point of geom g outermost along n."""
    kind, s, c = geometry.kind[g], row(geometry.size, g), row(t, g)
    if kind == SPHERE:
        return along(c, s[0], n)
    m = to_local(R, g, n)
    if kind == CAPSULE:
        return along(along(c, s[0], n), math.copysign(s[1], m[2]), axis(R, g))
    if kind == ELLIPSOID:
        p, _ = on_ellipsoid(s, m)
    elif kind == CYLINDER:
        side = math.hypot(m[0], m[1])
        x, y = (m[0] / side, m[1] / side) if side > 0.0 else (1.0, 0.0)
        p = (s[0] * x, s[0] * y, math.copysign(s[1], m[2]))
    elif s[0] > 0.0:  # a box
        p = (math.copysign(0.5 * s[0], m[0]), math.copysign(0.5 * s[1], m[1]), math.copysign(0.5 * s[2], m[2]))
    else:
        p = row(geometry.vertices, deepest_vertex(geometry, g, m))
    return along(c, 1.0, to_world(R, g, p))


@in_place
def separation(geometry, i, j, R, t, n):
    """Gap of two geoms along n (width of the slab of normal n between them), and the support points p, q.

    The signed distance is the largest gap over all n, so that any n bounds it from below.
    """
    p = support(geometry, i, R, t, n)
    q = support(geometry, j, R, t, times(-1.0, n))
    return dot(n, minus(q, p)), p, q


@in_place
def gap_along(geometry, i, j, R, t, n):
    """`separation` of two geoms along n, or along the normal of a half-space if one of them is one."""
    for h, g in ((i, j), (j, i)):
        if geometry.kind[h] == HALFSPACE:
            up = to_world(R, h, row(geometry.size, h))
            return dot(up, minus(support(geometry, g, R, t, times(-1.0, up)), row(t, h))) - geometry.offset[h]
    return separation(geometry, i, j, R, t, n)[0]


@in_place
def curvature(geometry, g, R, n, a, b):
    """Form a·(dp/dn) b of the support point p of an ellipsoid or of the rim of a cylinder; else 0."""
    kind, s = geometry.kind[g], row(geometry.size, g)
    if kind == CYLINDER:
        tangent, side = unit(cross(axis(R, g), n))
        return s[0] / side * dot(tangent, a) * dot(tangent, b) if side > 0.0 else 0.0
    if kind == ELLIPSOID:
        p, height = on_ellipsoid(s, to_local(R, g, n))
        u, v = to_local(R, g, a), to_local(R, g, b)
        stretched = s[0] ** 2 * u[0] * v[0] + s[1] ** 2 * u[1] * v[1] + s[2] ** 2 * u[2] * v[2]
        return (stretched - dot(p, u) * dot(p, v)) / height
    return 0.0
