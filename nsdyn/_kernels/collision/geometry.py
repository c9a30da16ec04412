"""Shapes of all geoms as flat arrays, and their poses in the world."""

from typing import NamedTuple

import numpy as np

from nsdyn._kernels.compiled import no_alloc
from nsdyn._kernels.vectors import put, row


class Geometry(NamedTuple):
    """Shapes of all geoms (see `nsdyn.scene.shapes.Shape`) as flat arrays, and their placements on the frames.

    Geom g has the vertices ``vertex_ptr[g]:vertex_ptr[g + 1]`` and the faces ``face_ptr[g]:face_ptr[g + 1]``. Face f
    has the corners ``loop[loop_ptr[f]:loop_ptr[f + 1]]``, counted from the first vertex of its geom.
    """

    kind: np.ndarray
    size: np.ndarray
    offset: np.ndarray
    radius: np.ndarray
    vertex_ptr: np.ndarray
    vertices: np.ndarray
    face_ptr: np.ndarray
    face_normals: np.ndarray
    face_offsets: np.ndarray
    loop_ptr: np.ndarray
    loop: np.ndarray
    frame: np.ndarray
    placement_R: np.ndarray
    placement_t: np.ndarray


Placed = NamedTuple("Placed", [*Geometry.__annotations__.items(), ("R", np.ndarray), ("t", np.ndarray)])
"""`Geometry` with poses in the world: R, shape (ngeoms, 3, 3), and t, shape (ngeoms, 3), m."""


class Found(NamedTuple):
    """Room for contacts, one row each: points, m, normals and gaps, m."""

    point: np.ndarray
    normal: np.ndarray
    gap: np.ndarray


@no_alloc(forceinline=True)
def write(out, at, point, normal, gap):
    """Write a contact into row `at` of a `Found`."""
    put(out.point, at, point)
    put(out.normal, at, normal)
    out.gap[at] = gap


@no_alloc(forceinline=True)
def move(out, source, at):
    """Copy the contact of row `source` to row `at` of a `Found`."""
    write(out, at, row(out.point, source), row(out.normal, source), out.gap[source])


@no_alloc(forceinline=True)
def smaller(geometry, i, j):
    """Smaller bounding radius of two geoms, m."""
    return min(geometry.radius[i], geometry.radius[j])


@no_alloc
def place(fields, x, R, out_R, out_t):
    """World pose of every geom on a moving frame; fixed geoms keep theirs. `fields` are those of `Geometry`."""
    geometry = Geometry(*fields)
    for g in range(geometry.kind.size):
        f = geometry.frame[g]
        if f < 0:
            continue
        for i in range(3):
            t = x[f, i]
            for k in range(3):
                t += R[f, i, k] * geometry.placement_t[g, k]
                out_R[g, i, k] = (
                    R[f, i, 0] * geometry.placement_R[g, 0, k]
                    + R[f, i, 1] * geometry.placement_R[g, 1, k]
                    + R[f, i, 2] * geometry.placement_R[g, 2, k]
                )
            out_t[g, i] = t
