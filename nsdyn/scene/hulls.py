"""Faces of convex hulls: Qhull returns triangles, and triangles in one plane are merged into one face."""

from __future__ import annotations

import numpy as np

from nsdyn.tools.arrays import Array, Index

COPLANAR = 1e-6
"""Facets are one face if their corners lie within this fraction of the hull's size of one plane (float32 meshes)."""


def faces(vertices: Array) -> list[Index]:
    """Return the faces of the convex hull of points, (n, 3), as loops of indices, anticlockwise seen from outside.

    Coplanar facets of Qhull are merged. ValueError for points in one plane, or as close to one as the corners of one
    face may be to theirs.
    """
    from scipy.spatial import ConvexHull, QhullError  # takes 0.1 s; boxes and spheres do not need it

    try:
        hull = ConvexHull(vertices - vertices.mean(axis=0))
    except QhullError:
        raise ValueError("vertices must span a volume: all of them lie in one plane") from None
    points, simplices, planes = hull.points, hull.simplices, hull.equations
    tol = COPLANAR * np.linalg.norm(np.ptp(points, axis=0))
    group = np.full(len(simplices), -1)
    loops = []
    # Largest facets first: their planes are the best defined, and thin facets are merged into them.
    area = np.linalg.norm(
        np.cross(points[simplices[:, 1]] - points[simplices[:, 0]], points[simplices[:, 2]] - points[simplices[:, 0]]),
        axis=1,
    )
    order = np.argsort(-area, kind="stable")
    thickness = np.abs(points @ planes[order[0], :3] + planes[order[0], 3]).max()
    if thickness <= tol:
        raise ValueError(f"vertices must span a volume: all of them lie within {thickness:.1g} m of one plane")
    for seed in order:
        if group[seed] >= 0:
            continue
        group[seed] = seed
        stack, members = [seed], []
        while stack:
            f = stack.pop()
            members.append(f)
            for g in hull.neighbors[f]:
                distance = np.abs(points[simplices[g]] @ planes[seed, :3] + planes[seed, 3]).max()
                if group[g] < 0 and distance <= tol:
                    group[g] = seed
                    stack.append(g)
        successor: dict[int, int] = {}
        edges = set()
        for f in members:
            a, b, c = (int(k) for k in simplices[f])
            if np.dot(np.cross(points[b] - points[a], points[c] - points[a]), planes[f, :3]) < 0.0:
                b, c = c, b
            edges |= {(a, b), (b, c), (c, a)}
        for a, b in edges:
            if (b, a) not in edges:
                successor[a] = b
        start = min(successor)
        loop = [start]
        while successor[loop[-1]] != start:
            loop.append(successor[loop[-1]])
        loops.append(np.array(loop))
    return loops
