"""Vectors as tuples of three floats, which the compiler keeps in registers."""

import math

from nsdyn._kernels.compiled import no_alloc


@no_alloc
def square(x):
    """Product x x. Python's own x ** 2 rounds otherwise, once in a thousand times."""
    return x * x


@no_alloc
def dot(a, b):
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@no_alloc
def cross(a, b):
    """Vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@no_alloc
def along(a, s, b):
    """Point a + s b."""
    return a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]


@no_alloc
def minus(a, b):
    """Difference a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@no_alloc
def times(s, a):
    """Multiple s a."""
    return s * a[0], s * a[1], s * a[2]


@no_alloc
def unit(a):
    """Direction of a, and its length; a itself where the length is 0 or not finite."""
    length = math.sqrt(dot(a, a))
    if length > 0.0 and length < math.inf:
        return (a[0] / length, a[1] / length, a[2] / length), length
    return a, length


@no_alloc
def perpendicular(d):
    """A unit vector perpendicular to the unit vector d, always the same for the same d; z if d is 0."""
    k = 0
    for i in range(1, 3):
        if abs(d[i]) < abs(d[k]):
            k = i
    e = (1.0 if k == 0 else 0.0, 1.0 if k == 1 else 0.0, 1.0 if k == 2 else 0.0)
    v, _ = unit(along(e, -d[k], d))
    return v if dot(d, d) > 0.0 else (0.0, 0.0, 1.0)


@no_alloc
def row(a, k):
    """Row k of an array as a vector."""
    return a[k, 0], a[k, 1], a[k, 2]


@no_alloc
def adjugate(A):
    """Columns of det(A) A⁻¹ of a 3 x 3 array, and det(A)."""
    a, b, c = row(A, 0), row(A, 1), row(A, 2)
    x = cross(b, c)
    return (x, cross(c, a), cross(a, b)), dot(a, x)


@no_alloc
def three(a, i):
    """Entries i, i + 1, i + 2 of a flat array as a vector."""
    return a[i], a[i + 1], a[i + 2]


@no_alloc
def four(a, k):
    """Row k of an array of quaternions, xyzw."""
    return a[k, 0], a[k, 1], a[k, 2], a[k, 3]


@no_alloc
def turned(q, e):
    """Product q e of quaternions xyzw, and its length."""
    p = (
        q[3] * e[0] + q[0] * e[3] + q[1] * e[2] - q[2] * e[1],
        q[3] * e[1] - q[0] * e[2] + q[1] * e[3] + q[2] * e[0],
        q[3] * e[2] + q[0] * e[1] - q[1] * e[0] + q[2] * e[3],
        q[3] * e[3] - q[0] * e[0] - q[1] * e[1] - q[2] * e[2],
    )
    return p, math.sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2] + p[3] * p[3])


@no_alloc
def put(a, k, v):
    """Write the vector v into row k of an array."""
    a[k, 0], a[k, 1], a[k, 2] = v


@no_alloc
def to_world(R, g, v):
    """Product R[g] v: a vector of the shape frame of geom g in the world frame."""
    return (
        R[g, 0, 0] * v[0] + R[g, 0, 1] * v[1] + R[g, 0, 2] * v[2],
        R[g, 1, 0] * v[0] + R[g, 1, 1] * v[1] + R[g, 1, 2] * v[2],
        R[g, 2, 0] * v[0] + R[g, 2, 1] * v[1] + R[g, 2, 2] * v[2],
    )


@no_alloc
def to_local(R, g, v):
    """Product R[g]ᵀ v: a vector of the world frame in the shape frame of geom g."""
    return (
        R[g, 0, 0] * v[0] + R[g, 1, 0] * v[1] + R[g, 2, 0] * v[2],
        R[g, 0, 1] * v[0] + R[g, 1, 1] * v[1] + R[g, 2, 1] * v[2],
        R[g, 0, 2] * v[0] + R[g, 1, 2] * v[1] + R[g, 2, 2] * v[2],
    )


@no_alloc
def axis(R, g):
    """The z axis of geom g in the world frame."""
    return R[g, 0, 2], R[g, 1, 2], R[g, 2, 2]
