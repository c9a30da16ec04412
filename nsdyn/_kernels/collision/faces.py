"""Faces of polytopes, half-spaces and caps of cylinders, and features of the other shape over them."""

import math

from nsdyn._kernels.collision.geometry import Placed, place, smaller
from nsdyn._kernels.collision.kinds import HALFSPACE, face_count, face_normal, has_corner
from nsdyn._kernels.collision.separation import INSIDE, SHARP, separation
from nsdyn._kernels.compiled import kernel, no_alloc
from nsdyn._kernels.vectors import dot, minus, put, row, times, to_local, to_world, unit

BIAS = 1e-6  # a face of geom 2 is the reference only if it fits better than that of geom 1 by more than round-off


@no_alloc(forceinline=True)
def aligned_face(geometry, g, n, angle):
    """Face of geom g whose normal is closest to n, and |difference|; (-1, inf) if that is not below `angle`."""
    m = to_local(geometry.R, g, n)
    best, face = angle * angle, -1
    for f in range(face_count(geometry, g)):
        e = minus(face_normal(geometry, g, f), m)
        square = dot(e, e)
        if square < best:
            best, face = square, f
    return face, math.sqrt(best) if face >= 0 else math.inf


@no_alloc
def reference_face(geometry, i, j, n, angle):
    """Reference face for the normal n: (face of geom i, -1), (-1, face of geom j), or (-1, -1) beyond `angle`."""
    face1, error1 = aligned_face(geometry, i, n, angle)
    face2, error2 = aligned_face(geometry, j, times(-1.0, n), angle)
    if face1 >= 0 and error1 <= error2 + BIAS:
        return face1, -1
    return -1, face2


@no_alloc
def best_normal(geometry, i, j, n):
    """Face normal or line of centres with the best separation; n itself unless that is better by more than noise."""
    best, p, q = separation(geometry, i, j, n)
    best += INSIDE * smaller(geometry, i, j)
    between = minus(q, p)
    m, distance = unit(minus(row(geometry.t, j), row(geometry.t, i)))
    if distance > 0.0:
        gap, _, _ = separation(geometry, i, j, m)
        if gap > best:
            best, n = gap, m
    for g, sign in ((i, 1.0), (j, -1.0)):
        for f in range(face_count(geometry, g)):
            m = times(sign, to_world(geometry.R, g, face_normal(geometry, g, f)))
            if dot(m, between) > best:  # any two points give an upper bound of the separation along m
                gap, _, _ = separation(geometry, i, j, m)
                if gap > best:
                    best, n = gap, m
    return n


@no_alloc
def next_feature(geometry, g, face, main, m, low):
    """The first face of polytope g from `face` on (rows) that faces -m and has a corner with m·corner ≤ low.

    Corners of the face `main` do not count.
    """
    last = geometry.face_ptr[g + 1]
    while face < last:
        if face != main and dot(row(geometry.face_normals, face), m) < -SHARP:
            for p in range(geometry.loop_ptr[face], geometry.loop_ptr[face + 1]):
                corner = geometry.loop[p]
                height = dot(row(geometry.vertices, geometry.vertex_ptr[g] + corner), m)
                if height <= low and not has_corner(geometry, main, corner):
                    return face
        face += 1
    return last


@kernel
def ways(fields, frames, room, names, closed, which, normal):
    """Face normals, from geom 1 to geom 2, that separate the geoms of contacts; returns their number.

    Parameters
    ----------
    fields, frames, room : tuple
        As in `keys.gaps`.
    names : ndarray of int, shape (5, nc)
        Of the contacts, as in `ContactSet`.
    closed : float
        Penetration along a normal up to which the normal still counts as separating, m.
    which, normal : ndarray, shapes (n,), (n, 3)
        Room for all faces of the geoms of each contact: the index of the contact of each normal, and the normals.
    """
    place(fields, frames[0], frames[1], room[0], room[1])
    geometry, count = Placed(*fields, room[0], room[1]), 0
    for c in range(names.shape[1]):
        i, j = names[0, c], names[1, c]
        if geometry.kind[i] == HALFSPACE or geometry.kind[j] == HALFSPACE:  # half-spaces have no edges
            continue
        for g, sign in ((i, 1.0), (j, -1.0)):
            for f in range(face_count(geometry, g)):
                n = times(sign, to_world(geometry.R, g, face_normal(geometry, g, f)))
                if separation(geometry, i, j, n)[0] >= -closed:
                    which[count] = c
                    put(normal, count, n)
                    count += 1
    return count
