"""Keys of contacts: find the contacts of a configuration that continue contacts of the previous one."""

import numpy as np

from nsdyn._kernels.collision.geometry import Placed, place
from nsdyn._kernels.collision.separation import gap_along
from nsdyn._kernels.compiled import kernel, no_alloc
from nsdyn._kernels.sorting import order as order_of
from nsdyn._kernels.sorting import place_of
from nsdyn._kernels.vectors import dot, minus, put, row, to_local

CLOSED = 1e-8
"""Gap over the radius of the smaller geom up to which a contact counts as closed: ten gap tolerances of the smallest
body, for what a loose solution leaves."""

NEAR = 0.01
"""Distance over the radius of the smaller geom within which a closed contact goes on though an open one is nearer.
Farther off, its velocities would change by as much as if the point had moved that far."""


@kernel
def match(geoms, tolerance, memory, next_key, names, points):
    """Give contacts the keys of the contacts that they continue; new ones count up from next_key, which is returned.

    Both lists, (names, points) and for the old ones scalars as in `search.gather`, are sorted by pair. Within a pair
    old contacts that were closed are matched first, to new ones that are `NEAR`: where features turn flush, two
    contacts become one, which goes on carrying. Of these, and then of the others, the closest old and new points are
    matched first. Their distance is the smaller of those seen from geom 1 and from geom 2. It is at most `tolerance`
    times the radius of the smaller geom plus the `slack` (ngeoms,) of both, by which they may have moved. The only
    contact of a pair always continues the only previous one. `geoms` is (radius, R, t, slack).
    """
    radius, R, t, slack = geoms
    first, second, key, point, local1, local2 = names[0], names[1], names[4], points[0], points[2], points[3]
    old1, old2, old_key, old_local1, old_local2 = memory[0][0], memory[0][1], memory[0][4], memory[1][2], memory[1][3]
    old_gap = memory[2][0]
    count = first.size
    used = np.zeros(old1.size, dtype=np.bool_)
    o = 0
    a = 0
    while a < count:
        i, j = first[a], second[a]
        b = a
        while b < count and first[b] == i and second[b] == j:
            put(local1, b, to_local(R, i, minus(row(point, b), row(t, i))))
            put(local2, b, to_local(R, j, minus(row(point, b), row(t, j))))
            key[b] = -1
            b += 1
        while o < old1.size and (old1[o] < i or (old1[o] == i and old2[o] < j)):
            o += 1
        q = o
        while q < old1.size and old1[q] == i and old2[q] == j:
            q += 1
        size = min(radius[i], radius[j])
        reach = tolerance * size + slack[i] + slack[j]
        if b - a == 1 and q - o == 1:
            reach = np.inf
        for most, far in ((CLOSED * size, NEAR * size), (np.inf, reach)):
            for _ in range(min(b - a, q - o)):
                best, new, old = far * far, -1, -1
                for c in range(a, b):
                    for e in range(o, q):
                        if key[c] < 0 and not used[e] and old_gap[e] <= most:
                            d1 = minus(row(local1, c), row(old_local1, e))
                            d2 = minus(row(local2, c), row(old_local2, e))
                            square = min(dot(d1, d1), dot(d2, d2))
                            if square < best:
                                best, new, old = square, c, e
                if new < 0:
                    break
                key[new] = old_key[old]
                used[old] = True
        for c in range(a, b):
            if key[c] < 0:
                key[c] = next_key
                next_key += 1
        a, o = b, q
    return next_key


@no_alloc
def kept(key, found_key, found_gap, out):
    """True if exactly the same contacts are found again; their gaps are then written into out."""
    if key.size != found_key.size:
        return False
    for c in range(key.size):
        if key[c] != found_key[c]:
            return False
        out[c] = found_gap[c]
    return True


@kernel
def gaps(fields, frames, room, contacts, found, out):
    """Gaps of contacts at a later configuration, into out: those of the same keys there, or else between whole geoms.

    A contact whose key is not found gets the separation of its geoms along its normal. This is raised to the least gap
    found between the geoms, which is their distance, or to 0 if none was found. The reason: the normal may have turned
    with the body from which the contact has moved away.

    Parameters
    ----------
    fields : tuple
        Of `Geometry`.
    frames, room : tuple
        (x, R), poses of the frames, and room for (R, t) of the geoms.
    contacts, found : (names, points, scalars)
        The latter are sorted.
    out : ndarray
    """
    (x, R_frames), (R, t) = frames, room
    (names, points, _), (found_names, _, scalars) = contacts, found
    key, found_gap, order, n, placed = names[4], scalars[0], order_of(found_names[4]), R.shape[0], False
    known, pairs = found_names[4][order], found_names[0] * n + found_names[1]
    for c in range(key.size):
        at = place_of(known, key[c])
        if at < known.size and known[at] == key[c]:
            out[c] = found_gap[order[at]]
            continue
        if not placed:
            place(fields, x, R_frames, R, t)
            placed = True
        code, least = names[0, c] * n + names[1, c], np.inf
        at = place_of(pairs, code)
        while at < pairs.size and pairs[at] == code:
            least = min(least, found_gap[at])
            at += 1
        apart = gap_along(Placed(*fields, R, t), names[0, c], names[1, c], row(points[1], c))
        out[c] = max(apart, least if least < np.inf else 0.0)
