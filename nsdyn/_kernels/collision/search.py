"""The contacts of a configuration in one call: geoms in place, points of the candidate pairs, keys."""

from nsdyn._kernels.collision.broadphase import follow
from nsdyn._kernels.collision.keys import collect
from nsdyn._kernels.collision.manifold import manifolds
from nsdyn._kernels.compiled import kernel
from nsdyn._kernels.packing import indices, matrices, numbers, triples

LEFT = -1
"""Instead of a number of contacts: a geom has left its fat box, and the pairs are to be renewed first."""

GEOMS, PAIRS = 22, 7
"""How many arrays of floats the packed geoms and pairs have."""


@kernel
def search(geoms, pairs, limit, tolerance, placed, poses, memory, next_key, out):
    """Number of contacts, or `LEFT`, and the next key; the contacts into `out` if it has room for just so many.

    `follow` first unless the geoms are `placed`, then `manifolds` and, if there is room, `collect`. Their arguments are
    `geoms` and `pairs`, packed by the detector, poses = (x, R, reach) of the frames, memory =
    (names, points) and out = (names, points, scalars).
    """
    f, i = geoms
    radius, frame = numbers(f, i, 2), indices(i, 5, GEOMS)
    R, t, reach = matrices(f, i, 8), triples(f, i, 9), numbers(f, i, 10)
    fields = (
        indices(i, 0, GEOMS), triples(f, i, 0), numbers(f, i, 1), radius, indices(i, 1, GEOMS), triples(f, i, 3),
        indices(i, 2, GEOMS), triples(f, i, 4), numbers(f, i, 5), indices(i, 3, GEOMS), indices(i, 4, GEOMS), frame,
        matrices(f, i, 6), triples(f, i, 7),
    )  # fmt: skip
    if not placed and follow(
        fields, poses[0], poses[1], poses[2], numbers(f, i, 12), R, t, reach, triples(f, i, 13), triples(f, i, 14),
        triples(f, i, 15), triples(f, i, 16),
    ):  # fmt: skip
        return LEFT, next_key
    p, j = pairs
    point, normal, gap, pair = triples(p, j, 0), triples(p, j, 1), numbers(p, j, 2), indices(j, 0, PAIRS)
    first, second, coal = indices(j, 1, PAIRS), indices(j, 2, PAIRS), numbers(p, j, 3)
    count = manifolds(
        fields, R, t, numbers(f, i, 11), first, second, indices(j, 3, PAIRS), coal.reshape((coal.size // 10, 10)),
        numbers(p, j, 4), reach, limit, triples(f, i, 17), triples(f, i, 18), numbers(f, i, 19), triples(f, i, 20),
        numbers(f, i, 21), point, normal, gap, pair,
    )  # fmt: skip
    if count == out[0].shape[1]:
        next_key = collect(
            pair, first, second, frame, numbers(p, j, 5), numbers(p, j, 6), point, normal, gap, radius, R, t, tolerance,
            reach, memory[0], memory[1], next_key, out[0], out[1], out[2],
        )  # fmt: skip
    return count, next_key
