"""A step of free bodies that meets nothing new, its stages in a row in one call.

Each stage is made of the kernels that the general step of `nsdyn.stepping.move` calls, so that both give the same bits.
What a call takes for its arguments is more than all that is done for a few bodies: a state is an array of floats, its
results first, then what it has of the bodies and of the contacts, one column after the other.
"""

import math

import numpy as np

from nsdyn._kernels.clock import seconds
from nsdyn._kernels.collision.search import LEFT, search
from nsdyn._kernels.compiled import in_place, kernel
from nsdyn._kernels.dynamics import motion
from nsdyn._kernels.packing import indices, matrices, numbers, triples
from nsdyn._kernels.problem.gauss import certificate_of
from nsdyn._kernels.reductions import least
from nsdyn._kernels.solvers.start import by_factors
from nsdyn._kernels.stepping import account as _account
from nsdyn._kernels.stepping import free, persistence, reversal, touching

DONE, OTHERWISE, LOOK, SOLVE, LOOK_AHEAD = range(5)
"""How a call ends: the step is made; it is not quiet; geoms are to be placed, or Coal asked, where the impulses act;
the problem is to be solved; the geoms where it ends. After the last three it goes on with what Python has done."""

# The packed arrays of the system: floats, then integers.
(
    MOMENTS,
    AXES,
    INVERSE_MASS,
    INVERSE_J,
    RADIUS,
    MASS,
    INERTIA,
    M,
    MINV,
    GRAVITY,
    NO_LOAD,
    ARM,
    NOWHERE,
    NUMBERS,
    SYSTEM,
) = range(15)
BLOCK_OF_FRAME, OFFSET, M_START = range(3)

# The last of the floats: numbers, with the names that they have in `System`, `Closing`, `Auto` and `gauss`.
(
    WEIGHT,
    STEP,
    THETA,
    CLOSED,
    SHALLOW,
    UNTIL,
    FASTEST,
    SLOW,
    STILL,
    ELASTIC,
    HALF,
    LEAST,
    TOL,
    OWN,
    ENOUGH,
    GOOD,
    DENSE,
    PENALTY,
    MAX_ITER,
    FEW,
    WEAK,
    GEOMS,
) = range(22)

# The results of a step.
(
    KINETIC,
    POTENTIAL,
    EXTERNAL,
    NORMAL,
    FRICTION,
    NUMERICS,
    NORM,
    ERROR,
    RESIDUAL,
    COUNT,
    TIME,
    CERTIFIED,
    GAP,
    SHIFT,
    BOUND,
    COULOMB,
    WENT,
    GOES,
    RESULTS,
) = range(19)

# First columns of a body in a state, of a contact, of a contact in what was found, and of both in what is at work.
X, QUATERNION, V, R, LINEAR, ANGULAR, LOOKED, RATE, BODY = 0, 3, 7, 13, 22, 25, 28, 41, 47
FORCE, IMPULSE, U, FREE, U_END, NORMAL_WORK, FRICTION_WORK, GAP_END, CONTACT = 0, 3, 6, 9, 12, 15, 16, 17, 18
FRAMES, ROWS, SCALES, FOUND = 15, 24, 60, 61
BLOCKS, STARTS, FOUND_NAMES, SIZE, MADE = 5, 7, 9, 0, 1
R_THERE, V_THERE, V_FREE, V_PLUS, REACH, LOOKED_THERE, TURN, BODY_WORK = 7, 16, 22, 28, 34, 35, 48, 54
LOCAL, FORESEEN, ISLANDS, PROJECTED, COUPLES, LEFT_OVER, CONTACT_WORK = 0, 15, 16, 19, 22, 25, 26


@kernel(inline="always")
def column(f, k, n):
    """The column k of arrays of n numbers."""
    return f[k * n : (k + 1) * n]


@kernel(inline="always")
def vectors(f, k, n):
    """The columns from k on as (n, 3)."""
    return f[k * n : (k + 3) * n].reshape((n, 3))


@kernel(inline="always")
def quaternions(f, k, n):
    """The columns from k on as (n, 4)."""
    return f[k * n : (k + 4) * n].reshape((n, 4))


@kernel(inline="always")
def rotations(f, k, n):
    """The columns from k on as (n, 3, 3)."""
    return f[k * n : (k + 9) * n].reshape((n, 3, 3))


@kernel(inline="always")
def velocity(f, k, n):
    """The columns from k on as (6 n,)."""
    return f[k * n : (k + 6) * n]


@kernel(inline="always")
def placed(f, k, n):
    """(x, R, reach) of the columns from k on, as of `Looked`."""
    return vectors(f, k, n), rotations(f, k + 3, n), column(f, k + 12, n)


@kernel(inline="always")
def contacts(found, nc):
    """(names, points, scalars) of what was found, as `search` gives them."""
    f, i = found
    return i[: 5 * nc].reshape((5, nc)), f[: 12 * nc].reshape((4, nc, 3)), f[12 * nc : 15 * nc].reshape((3, nc))


@kernel(inline="always")
def rows(found, nc):
    """(frame, block, start, H, scales, its size and whether they are made) of what was found, as of `free.meet`."""
    f, i = found
    return (
        rotations(f, FRAMES, nc),
        i[BLOCKS * nc : STARTS * nc].reshape((nc, 2)),
        i[STARTS * nc : FOUND_NAMES * nc].reshape((nc, 2)),
        f[ROWS * nc : SCALES * nc],
        column(f, SCALES, nc),
        i[FOUND_NAMES * nc :],
    )


@in_place
def bounces(num, met, x, twists, rates):
    """Whether anything that may rebound strikes or parts faster than what rests, as of `System.rests`."""
    names, points, scalars = met
    where = names[2], names[3], points[0], points[1], x
    for c in range(names.shape[1]):
        e = scalars[2, c]
        if e > 0.0:
            u = touching.approach_of(c, where, twists)
            rests = num[HALF] * touching.weight_of(c, where, rates) * max(1.0 - e, num[LEAST])
            if u > num[TOL] + rests or u < -(num[TOL] + rests / e):
                return True
    return False


@in_place
def depart(num, bodies, forces, arm, met, last, old, f, w):
    """The first half of a step; (whether it may be quiet, whether contacts are those where it begins).

    last = (keys, pairs of shapes, states) of what acted last.
    """
    n, h = arm.size, num[STEP]
    names, points, scalars = met
    x, twists, v = vectors(old, X, n), (vectors(old, LINEAR, n), vectors(old, ANGULAR, n)), velocity(old, V, n)
    for c in range(names.shape[1]):
        if not scalars[0, c] <= num[CLOSED]:
            return False, False
    closed = names[4], names[0], names[1], scalars[0], scalars[2]
    where = names[2], names[3], points[0], points[1], x
    if touching.striking_speed(closed, where, twists, last, int(num[GEOMS]), num[CLOSED]) < -num[SLOW] / h:
        return False, False
    there = vectors(w, X, n), quaternions(w, QUATERNION, n), velocity(w, V_THERE, n), rotations(w, R_THERE, n)
    reach, far_rate, v_free = column(w, REACH, n), velocity(f, RATE, n), velocity(w, V_FREE, n)
    far, same = free.half(
        bodies,
        forces,
        (x, quaternions(old, QUATERNION, n), v),
        h,
        num[THETA],
        placed(old, LOOKED, n),
        (arm, num[STILL]),
        (*there, v_free, far_rate, reach),
    )
    if far > num[FASTEST]:
        return False, False
    if num[ELASTIC] > 0.0:
        change, rates = velocity(w, V_PLUS, n), (vectors(w, LOOKED_THERE, n), vectors(w, LOOKED_THERE + 3, n))
        for i in range(change.size):
            change[i] = (v_free[i] - v[i]) / h
        motion.twists(rotations(old, R, n), change, n, *rates)
        if bounces(num, met, x, twists, rates):
            return False, False
    return True, same


@in_place
def look(detection, ready, looked, before, next_key, met, known):
    """Find contacts, which go on from those `before`: 0 if they are as many, all `known` and closed, else LEFT or 1.

    known = (keys, gaps, largest gap of what is closed).
    """
    geoms, pairs, limit, tolerance = detection
    nc = met[0].shape[1]
    count, _ = search(geoms, pairs, limit, tolerance, ready, looked, (before[0], before[1]), next_key, met)
    if count == LEFT:
        return LEFT
    return 0 if count == nc and touching.all_known(met[0][4], *known) else 1


@in_place
def pose(num, masses, begin, last, met, rows, w, own, place, slides, b):
    """The problem of the step: the size of H, the norm of b, and its validity.

    begin = (contacts where the step begins, its bodies), last = (keys, forces, states) of what acted last, rows as of
    `free.meet`.
    """
    n, nc = masses[0].size, place.size
    (names, points, _), old = begin
    key, scalars = met[0][4], met[2]
    return free.meet(
        masses,
        (
            key,
            met[0][2],
            met[0][3],
            met[1][0],
            met[1][1],
            scalars[0],
            vectors(w, LOOKED_THERE, n),
            rotations(w, LOOKED_THERE + 3, n),
        ),
        (
            names[4],
            points[0],
            points[1],
            vectors(old, X, n),
            vectors(old, LINEAR, n),
            vectors(old, ANGULAR, n),
            column(w, REACH, n),
        ),
        (velocity(old, V, n), velocity(w, V_THERE, n), velocity(w, V_FREE, n)),
        (last[0], last[1], num[STEP], last[2]),
        (scalars[1], scalars[2], (num[CLOSED], num[SHALLOW], num[THETA] * num[STEP], num[UNTIL])),
        rows,
        (own[: 15 * nc].reshape((5, 3 * nc)), column(own, FORESEEN, nc), place, slides, b),
    )


@in_place
def solve(num, problem, r, u, own, label, out):
    """Solve the problem (blocks, b, mu, scales) from r in place, u with it; whether that is all it takes."""
    blocks, b, mu, scales = problem
    nc = mu.size
    out[COUNT], out[ERROR], out[RESIDUAL] = 0.0, 0.0, 0.0
    if nc == 0:
        return True
    limits = int(num[DENSE]), num[PENALTY], int(num[MAX_ITER]), int(num[FEW])
    islands = own[ISLANDS * nc : (ISLANDS + 3) * nc].reshape((3, nc))
    given = blocks, b, mu, scales, r, u, label, islands, num[ENOUGH], num[GOOD], limits
    _, left, count, top, residual = by_factors(*given)
    out[COUNT], out[ERROR], out[RESIDUAL] = count, top / out[NORM], residual
    return not left and out[ERROR] <= num[TOL] and residual <= num[TOL]


@in_place
def arrive(num, bodies, blocks, arm, nowhere, r, f, w):
    """The second half of a step; whether contacts are those where the impulses acted."""
    n = arm.size
    return free.end(
        blocks,
        r,
        velocity(w, V_FREE, n),
        bodies,
        (vectors(w, X, n), quaternions(w, QUATERNION, n)),
        num[THETA] * num[STEP],
        (placed(w, LOOKED_THERE, n), nowhere, arm, num[STILL]),
        (
            velocity(w, V_PLUS, n),
            vectors(f, X, n),
            quaternions(f, QUATERNION, n),
            velocity(f, V, n),
            rotations(f, R, n),
            vectors(f, LINEAR, n),
            vectors(f, ANGULAR, n),
        ),
    )


@in_place
def unfinished(num, blocks, inverse_J, arm, met, r, flags, gap, f, w, own):
    """Whether contacts that persist do work, or have gaps where the step ends: `nsdyn.stepping.persistence`."""
    (names, points, scalars), (slides, stays, sticks, other), n, nc = met, flags, arm.size, gap.size
    mean, v, v_plus = velocity(w, V_FREE, n), velocity(w, V_THERE, n), velocity(w, V_PLUS, n)
    for i in range(mean.size):
        mean[i] = 0.5 * (v[i] + v_plus[i])
    couple, left = own[COUPLES * nc : (COUPLES + 3) * nc].reshape((nc, 3)), column(own, LEFT_OVER, nc)
    for c in range(nc):
        couple[c, 0], couple[c, 1], couple[c, 2], left[c] = 0.0, 0.0, 0.0, np.inf
    persistence.couples(
        blocks,
        (names[0], names[1], names[2], names[3], points[1]),
        mean,
        (rotations(w, R_THERE, n), inverse_J, arm, num[STEP]),
        (r, scalars[1]),
        (stays, sticks, slides),
        (couple, velocity(w, TURN, n), left, other),
    )
    begun, ended = w[LOOKED_THERE * n :], f[LOOKED * n :]
    for c in range(nc):
        if other[c] or (stays[c] and r[3 * c] > 0.0 and abs(gap[c]) > num[CLOSED]):
            for b in (names[2, c], names[3, c]):
                if b >= 0:
                    for i in range(3 * b, 3 * b + 3):
                        if begun[i] != ended[i]:
                            return True
                    for i in range(3 * n + 9 * b, 3 * n + 9 * b + 9):
                        if begun[i] != ended[i]:
                            return True
    return False


@in_place
def book(num, bodies, blocks, met, frame, flags, direction, scales, status, f, w, own, acted):
    """What the step did: works, states, forces, energies and the certificate."""
    mass, J, gravity, no_load, none = bodies
    n, nc, out, h = mass.size, status.size, f, num[STEP]
    b, mu, r = f[RESULTS:], met[2][1], acted[IMPULSE * nc : (IMPULSE + 3) * nc]
    v, v_plus = velocity(w, V_THERE, n), velocity(w, V_PLUS, n)
    out[EXTERNAL], beyond, out[NORMAL], out[FRICTION], rest = _account.account(
        (mass, gravity, no_load, no_load),
        (h, num[THETA]),
        (v, v, v_plus),
        (blocks, none, mu, own[: 15 * nc].reshape((5, 3 * nc)), frame),
        r,
        (flags[1], flags[2], none, none),
        num[TOL],
        (
            status,
            column(acted, NORMAL_WORK, nc),
            column(acted, FRICTION_WORK, nc),
            acted[U_END * nc : (U_END + 3) * nc],
            vectors(acted, FORCE, nc),
        ),
    )
    out[NUMERICS] = beyond + rest
    out[KINETIC], out[POTENTIAL] = motion.free_energies(mass, J, gravity, vectors(b, X, n), velocity(b, V, n))
    projected = own[PROJECTED * nc : (PROJECTED + 3) * nc]
    outside, gap, shift, speed, step, total, square = certificate_of(
        blocks, acted[U * nc : (U + 3) * nc], r, mu, scales, direction, projected
    )
    certified = not outside and math.isfinite(gap + shift) and step <= num[WEAK] * speed
    out[CERTIFIED], out[GAP], out[SHIFT], out[BOUND], out[COULOMB] = 0.0, gap, shift, np.inf, np.nan
    if certified:
        half = 0.5 * step * math.sqrt(square)
        out[CERTIFIED], out[BOUND] = 1.0, half + math.sqrt(half * half + total)


@in_place
def quiet(system, detection, old, begun, new, middle, end, next_key, direction, work, stage, ready, asks):
    """Everything dt later, or as far as it goes without Python: `DONE`, `OTHERWISE`, `LOOK`, `SOLVE` or `LOOK_AHEAD`.

    Parameters
    ----------
    system : tuple
        The packed arrays (floats, integers).
    detection : tuple
        What `search` takes first: geoms, pairs, most points of a pair, tolerance.
    old, new : tuple
        States: floats; keys, then pairs of shapes of the contacts that acted; what these were, of int8.
    begun, middle, end : tuple
        What was found where the step begins, where its impulses act and where it ends, with the rows of W for the
        former two: floats, integers. The last two have no room until something moves.
    next_key : int
    direction : ndarray
        On which the last certificate rests.
    work : tuple
        Room: floats, integers, flags (4, nc).
    stage : int
        0, or how the last call ended.
    ready : bool
        Whether Python has placed the geoms, and asked Coal of the pairs.
    asks : bool
        Whether Coal is asked of any pair.
    """
    (sf, si), (f, acted, status), (f_old, acted_old, status_old), (w, whole, flags) = system, new, old, work
    num, arm, nowhere = numbers(sf, si, NUMBERS), numbers(sf, si, ARM), numbers(sf, si, NOWHERE)
    n, nc, last, out = arm.size, status.size, status_old.size, f
    bodies = (
        triples(sf, si, MOMENTS),
        matrices(sf, si, AXES),
        numbers(sf, si, INVERSE_MASS),
        matrices(sf, si, INVERSE_J),
        numbers(sf, si, RADIUS),
    )
    gravity, no_load, mass = numbers(sf, si, GRAVITY), triples(sf, si, NO_LOAD), numbers(sf, si, MASS)
    masses = (
        indices(si, BLOCK_OF_FRAME, SYSTEM),
        indices(si, OFFSET, SYSTEM),
        indices(si, M_START, SYSTEM),
        numbers(sf, si, M),
        numbers(sf, si, MINV),
    )
    b, b_old, a = f[RESULTS : RESULTS + BODY * n], f_old[RESULTS : RESULTS + BODY * n], f[RESULTS + BODY * n :]
    r, u, q = a[IMPULSE * nc : U * nc], a[U * nc : FREE * nc], a[FREE * nc : U_END * nc]
    gap, own = column(a, GAP_END, nc), w[BODY_WORK * n :]
    place, label, room = whole[:nc], whole[nc : 2 * nc], whole[2 * nc :]
    first = contacts(begun, nc)

    if stage == 0:
        falling, before = (gravity, no_load, num[WEIGHT]), (acted_old[:last], acted_old[last:], status_old)
        may_be, same = depart(num, bodies, falling, arm, first, before, b_old, b, w)
        if not may_be:
            return OTHERWISE
        out[WENT], out[GOES] = 0.0 if same else 1.0, 0.0
        there = vectors(w, X, n), rotations(w, R_THERE, n), column(w, REACH, n)
        touching.look(placed(b_old, LOOKED, n), there, arm, num[STILL], placed(w, LOOKED_THERE, n))
        if not same and (asks or middle[0].size < FOUND * nc):
            return LOOK
    at = begun
    if out[WENT] > 0.0:
        at = middle
        if stage == 0 or stage == LOOK:
            known = first[0][4], first[2][0], num[CLOSED]
            into = contacts(middle, nc)
            found = look(detection, ready, placed(w, LOOKED_THERE, n), first, next_key, into, known)
            if found != 0:
                return LOOK if found == LEFT else OTHERWISE
            middle[1][FOUND_NAMES * nc + MADE] = 0
    met, (frame, block, start, H, scales, made) = contacts(at, nc), rows(at, nc)
    if stage == 0 or stage == LOOK:
        pressed = acted_old[:last], vectors(f_old[RESULTS + BODY * n :], FORCE, last), status_old
        of = frame, block, start, H[: made[SIZE]] if made[MADE] else H, scales, made[MADE] > 0
        made[SIZE], norm, good = pose(num, masses, (first, b_old), pressed, met, of, w, own, place, flags[0], q)
        made[MADE], out[NORM] = 1, norm if norm > 0.0 else 1.0
        if not good:
            return OTHERWISE
        guess = own[(LOCAL + 12) * nc : (LOCAL + 15) * nc]
        for i in range(r.size):
            r[i] = guess[i]
    blocks = masses[1], block, start, H[: made[SIZE]], *masses[2:]
    if stage == 0 or stage == LOOK:
        began = seconds(room)
        if num[OWN] == 0.0 or not solve(num, (blocks, q, met[2][1], scales), r, u, own, label, out):
            return SOLVE
        out[TIME] = seconds(room) - began
    if stage != LOOK_AHEAD:
        for c in range(nc):
            acted[c], acted[nc + c] = met[0][4, c], met[0][0, c] * int(num[GEOMS]) + met[0][1, c]
        if not reversal.goes_on(
            (r, u, q, met[2][1]),
            own[: 15 * nc].reshape((5, 3 * nc)),
            flags[0],
            (acted[:nc], acted[nc:]),
            (acted_old[:last], acted_old[last:], status_old),
            (first[0][4], first[2][0], num[CLOSED], num[STEP]),
            column(own, FORESEEN, nc),
            (flags[1], flags[2]),
        ):
            return OTHERWISE
        same = arrive(num, bodies, blocks, arm, nowhere, r, b, w)
        out[GOES] = 0.0 if same else 1.0
        there = vectors(b, X, n), rotations(b, R, n), nowhere
        touching.look(placed(w, LOOKED_THERE, n), there, arm, num[STILL], placed(b, LOOKED, n))
        if not same and (asks or end[0].size < FOUND * nc):
            return LOOK_AHEAD
    for c in range(nc):
        gap[c] = met[2][0, c]
    if out[GOES] > 0.0:
        known, into = (met[0][4], met[2][0], np.inf), contacts(end, nc)
        found = look(detection, ready and stage == LOOK_AHEAD, placed(b, LOOKED, n), met, next_key, into, known)
        if found != 0:
            return LOOK_AHEAD if found == LEFT else OTHERWISE
        end[1][FOUND_NAMES * nc + MADE] = 0
        touching.places(into[0][4], met[0][4], place)
        for c in range(nc):
            gap[c] = into[2][0, place[c]]
    if least(gap) < -num[CLOSED]:
        return OTHERWISE
    if out[GOES] > 0.0 and unfinished(num, blocks, bodies[3], arm, met, r, flags, gap, b, w, own):
        return OTHERWISE
    inertia = mass, matrices(sf, si, INERTIA), gravity, no_load, nowhere[:0]
    book(num, inertia, blocks, met, frame, flags, direction, scales, status, f, w, own, a)
    return DONE
