"""Find the contacts of a configuration: place the geoms, compute the points of candidate pairs, match keys."""

from nsdyn._kernels.collision.broadphase import follow
from nsdyn._kernels.collision.keys import match
from nsdyn._kernels.collision.manifold import manifolds
from nsdyn._kernels.compiled import no_alloc
from nsdyn._kernels.packing import indices, matrices, numbers, triples
from nsdyn._kernels.vectors import put, row

LEFT = -1
"""Returned instead of a number of contacts: a geom has left its enlarged box, and the pairs must be renewed first."""

# Indices of the arrays of floats and of integers that `Detector` packs, for the geoms and for the candidate pairs.
SIZE, OFFSET, RADIUS, VERTICES, NORMALS, OFFSETS, PLACEMENT_R, PLACEMENT_T = range(8)
ROTATION, ORIGIN, REACH, SLACK, BASE, LOWER, UPPER, FAT_LOWER, FAT_UPPER = range(8, 17)
POLY, OTHER, VALUES, POINTS, HEIGHTS, GEOMS = range(17, 23)
KIND, VERTEX_PTR, FACE_PTR, LOOP_PTR, LOOP, FRAME = range(6)
POINT, NORMAL, GAP, COAL, MARGIN, MU, RESTITUTION, PAIRS = range(8)
PAIR, FIRST, SECOND, SLOT = range(4)


@no_alloc
def fields_of(geoms):
    """Fields of `Geometry` from the packed arrays of the geoms."""
    f, i = geoms
    sizes = indices(i, KIND, GEOMS), triples(f, i, SIZE), numbers(f, i, OFFSET), numbers(f, i, RADIUS)
    vertices = indices(i, VERTEX_PTR, GEOMS), triples(f, i, VERTICES)
    faces = indices(i, FACE_PTR, GEOMS), triples(f, i, NORMALS), numbers(f, i, OFFSETS)
    loops = indices(i, LOOP_PTR, GEOMS), indices(i, LOOP, GEOMS)
    placements = indices(i, FRAME, GEOMS), matrices(f, i, PLACEMENT_R), triples(f, i, PLACEMENT_T)
    return *sizes, *vertices, *faces, *loops, *placements


@no_alloc
def room_of(geoms):
    """Arrays for the rotations and the origins of the geoms: R, t."""
    f, i = geoms
    return matrices(f, i, ROTATION), triples(f, i, ORIGIN)


@no_alloc
def seek(geoms, pairs, limit, placed, poses):
    """Find contacts: `follow`, unless the geoms are `placed` at the poses, then `manifolds`; their number, or `LEFT`.

    `geoms` and `pairs` are floats and integers, packed by the detector; the contacts are written there, at most `limit`
    of a pair. `poses` is (x, R, reach) of the moving frames, m.
    """
    (f, i), (p, j) = geoms, pairs
    fields, (R, t), reach = fields_of(geoms), room_of(geoms), numbers(f, i, REACH)
    boxes, fat = (triples(f, i, LOWER), triples(f, i, UPPER)), (triples(f, i, FAT_LOWER), triples(f, i, FAT_UPPER))
    if not placed and follow(fields, poses, numbers(f, i, BASE), (R, t, reach), boxes, fat):
        return LEFT
    found = triples(p, j, POINT), triples(p, j, NORMAL), numbers(p, j, GAP), indices(j, PAIR, PAIRS)
    first, second, coal = indices(j, FIRST, PAIRS), indices(j, SECOND, PAIRS), numbers(p, j, COAL)
    asked = indices(j, SLOT, PAIRS), coal.reshape((coal.size // 4, 4)), numbers(p, j, MARGIN)
    polygons, points = (triples(f, i, POLY), triples(f, i, OTHER)), (triples(f, i, POINTS), numbers(f, i, HEIGHTS))
    room = limit, *polygons, numbers(f, i, VALUES), *points
    placed = fields, R, t, reach, numbers(f, i, SLACK)
    return manifolds(placed, (first, second, *asked), room, found)


@no_alloc
def gather(geoms, pairs, tolerance, memory, next_key, out):
    """Write the contacts found by `seek` into out, with data of their pairs and geoms, and return the key of `match`.

    Parameters
    ----------
    geoms, pairs : (ndarray, ndarray)
        As in `seek`.
    tolerance : float
        Within which a contact is found again, as in `match`.
    memory : tuple
        names, points and scalars of the contacts of the previous configuration.
    next_key : int
        Key of the next new contact.
    out : tuple
        Arrays of exactly this size: names, shape (5, nc), both geoms, both frames, key; points, shape (4, nc, 3),
        point, normal, the point in the frames of both geoms; scalars, shape (3, nc), gap, mu, restitution.
    """
    (f, i), (p, j), (names, points, scalars) = geoms, pairs, out
    point, normal, gap, pair = triples(p, j, POINT), triples(p, j, NORMAL), numbers(p, j, GAP), indices(j, PAIR, PAIRS)
    first, second, frame = indices(j, FIRST, PAIRS), indices(j, SECOND, PAIRS), indices(i, FRAME, GEOMS)
    mu, restitution = numbers(p, j, MU), numbers(p, j, RESTITUTION)
    for c in range(names.shape[1]):
        k = pair[c]
        names[0, c], names[1, c], names[2, c], names[3, c] = first[k], second[k], frame[first[k]], frame[second[k]]
        scalars[0, c], scalars[1, c], scalars[2, c] = gap[c], mu[k], restitution[k]
        put(points[0], c, row(point, c))
        put(points[1], c, row(normal, c))
    shapes = numbers(f, i, RADIUS), *room_of(geoms), numbers(f, i, REACH)
    return match(shapes, tolerance, memory, next_key, names, points)
