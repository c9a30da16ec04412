"""A step of free bodies that meets no event, its stages in a row in one call.

Each stage is made of the kernels that the general step of `nsdyn.stepping.move` calls, so that both give the same bits.
"""

import math

import numpy as np

from nsdyn._kernels.clock import seconds
from nsdyn._kernels.collision import keys
from nsdyn._kernels.collision.search import LEFT, fields_of, gather, room_of, seek
from nsdyn._kernels.compiled import in_place, kernel
from nsdyn._kernels.dynamics import motion
from nsdyn._kernels.packing import indices, matrices, numbers, triples
from nsdyn._kernels.problem import blocks as _blocks
from nsdyn._kernels.problem.gauss import certificate_of
from nsdyn._kernels.reductions import copy, least
from nsdyn._kernels.solvers.start import by_factors, widest
from nsdyn._kernels.stepping import account as _account
from nsdyn._kernels.stepping import columns as col
from nsdyn._kernels.stepping import free, law, persistence, reversal, sight, touching
from nsdyn._kernels.stepping.workless import PASSES, SOLVES, workless
from nsdyn._kernels.stepping.workless import SOLVE as UNSOLVED

DONE, OTHERWISE, LOOK, SOLVE, LOOK_AHEAD, MORE = range(6)
"""How a call ends: the step is made; it is not quiet; geoms are to be placed, or Coal asked, where the impulses act;
the problem is to be solved; the geoms where it ends; there is no room for so many contacts. After LOOK, SOLVE and
LOOK_AHEAD it goes on with what Python has done."""

GAIN = 1e-5
"""Of the kinetic energy with which it begins, most that contacts that persist and projections may add in a step."""

SURELY = 0.5
"""Part of `GAIN` that contacts joined by bodies may add, so that those of any larger island add less than that: its
energy, at the velocity of all or at what gravity gives them, is at least half the sum of theirs."""


@in_place
def bounces(num, met, x, twists, rates):
    """Whether anything that is closed, and may rebound, strikes or parts faster than what rests, as `System.rests`."""
    names, points, scalars = met
    where = names[2], names[3], points[0], points[1], x
    for c in range(names.shape[1]):
        e = scalars[2, c]
        if e > 0.0 and scalars[0, c] <= num[col.CLOSED]:
            u = touching.approach_of(c, where, twists)
            rests = num[col.HALF] * touching.weight_of(c, where, rates) * max(1.0 - e, num[col.LEAST])
            if u > num[col.TOL] + rests or u < -(num[col.TOL] + rests / e):
                return True
    return False


@in_place
def strikes_at_once(num, met, last, old, n):
    """Whether what is closed strikes where the step begins; last = (keys, pairs of shapes, states) of what acted."""
    names, points, scalars = met
    where = names[2], names[3], points[0], points[1], col.vectors(old, col.X, n)
    closed, twists = (
        (names[4], names[0], names[1], scalars[0], scalars[2]),
        (col.vectors(old, col.LINEAR, n), col.vectors(old, col.ANGULAR, n)),
    )
    least_speed = touching.striking_speed(closed, where, twists, last, int(num[col.GEOMS]), num[col.CLOSED])
    return least_speed < -num[col.SLOW] / num[col.STEP]


@in_place
def depart(num, bodies, forces, arm, old, f, w):
    """The first half of a move: how far it reaches, and whether contacts are those where it begins."""
    n = arm.size
    there = (
        col.vectors(w, col.X, n),
        col.quaternions(w, col.QUATERNION, n),
        col.velocity(w, col.V_THERE, n),
        col.rotations(w, col.R_THERE, n),
    )
    reach, rate, v_free = col.column(w, col.REACH, n), col.velocity(f, col.RATE, n), col.velocity(w, col.V_FREE, n)
    return free.half(
        bodies,
        forces,
        (col.vectors(old, col.X, n), col.quaternions(old, col.QUATERNION, n), col.velocity(old, col.V, n)),
        num[col.STEP],
        num[col.THETA],
        col.placed(old, col.LOOKED, n),
        (arm, num[col.STILL]),
        (*there, v_free, rate, reach),
    )


@kernel
def rebounds(num, met, old, w, n):
    """Whether anything strikes where the step begins, or parts, faster than what rests, of what may rebound."""
    v, v_free, change, rates = (
        col.velocity(old, col.V, n),
        col.velocity(w, col.V_FREE, n),
        np.empty(6 * n),
        np.empty((2, n, 3)),
    )
    for i in range(change.size):
        change[i] = (v_free[i] - v[i]) / num[col.STEP]
    motion.twists(col.rotations(old, col.R, n), change, n, rates[0], rates[1])
    twists = col.vectors(old, col.LINEAR, n), col.vectors(old, col.ANGULAR, n)
    return bounces(num, met, col.vectors(old, col.X, n), twists, (rates[0], rates[1]))


@in_place
def look(detection, ready, looked, before, next_key, into, head, which, most):
    """Find contacts, which go on from those `before`, and `DONE`; else `LOOK` or, if they are too many, `MORE`."""
    geoms, pairs, limit, tolerance = detection
    count = seek(geoms, pairs, limit, ready, looked)
    if count == LEFT:
        return LOOK
    head[which] = head[col.NEEDED] = count
    if count > most or col.FOUND * count > into[0].size:
        return MORE
    room = col.contacts(into, count)
    head[col.KEY_MIDDLE + which - col.MIDDLE] = gather(geoms, pairs, tolerance, (before[0], before[1]), next_key, room)
    into[1][col.FOUND_NAMES * count + col.MADE] = 0
    return DONE


@kernel
def catch(num, bodies, first, found, last, old, w, barred, out):
    """Which contacts that are found the move meets, into out (nc,), as of `nsdyn.stepping.sight.caught`; how many.

    bodies = (arm, radii of balls inside the shapes), old: the bodies where the move begins.
    """
    (arm, inscribed), h, size = bodies, num[col.STEP], int(num[col.GEOMS])
    n = arm.size
    (names, points, scalars), (before, begun, known) = found, first
    nc, v, v_begin, x = (
        names.shape[1],
        col.velocity(w, col.V_FREE, n),
        col.velocity(old, col.V, n),
        col.vectors(w, col.X, n),
    )
    rate, twists, gap = np.empty(v.size), np.empty((5, 2, n, 3)), known[0].copy()
    for i in range(rate.size):
        rate[i] = (v[i] - v_begin[i]) / h
    closed, tol, bounces_of = num[col.CLOSED], num[col.TOL], (num[col.HALF], num[col.LEAST])
    if num[col.ELASTIC] > 0.0 and known[2].any():
        R, where = col.rotations(old, col.R, n), (before[2], before[3], begun[0], begun[1], col.vectors(old, col.X, n))
        motion.twists(R, v_begin, n, twists[3, 0], twists[3, 1])
        motion.twists(R, rate, n, twists[4, 0], twists[4, 1])
        moving = (twists[3, 0], twists[3, 1]), (twists[4, 0], twists[4, 1])
        sight.parting(where, np.zeros(gap.size), known[0], known[2], moving, (closed, tol, bounces_of), gap)
    if touching.all_known(names[4], before[4], gap, closed):
        out[:] = True
        return nc
    pair, deep, R = np.empty(nc, np.int64), np.empty(nc), col.rotations(w, col.R_THERE, n)
    for c in range(nc):
        pair[c] = names[0, c] * size + names[1, c]
        deep[c] = num[col.DEPTH] * min(inscribed[names[0, c]], inscribed[names[1, c]])
    motion.twists(R, v_begin, n, twists[0, 0], twists[0, 1])
    motion.twists(R, v, n, twists[1, 0], twists[1, 1])
    motion.twists(R, rate, n, twists[2, 0], twists[2, 1])
    sight.caught(
        (names[4], pair, deep, scalars[0], scalars[2]),
        (names[2], names[3], points[0], points[1], x),
        np.zeros(nc),
        ((twists[0, 0], twists[0, 1]), (twists[1, 0], twists[1, 1]), (twists[2, 0], twists[2, 1])),
        (before[4], gap, closed),
        last,
        (num[col.THETA] * h, h, tol, bounces_of),
        barred,
        out,
    )
    return out.sum()


@in_place
def take(found, which, into):
    """The contacts `which` (nc,) of those found."""
    k = 0
    for c in range(which.size):
        if which[c]:
            for i in range(5):
                into[0][i, k] = found[0][i, c]
            for i in range(4):
                for j in range(3):
                    into[1][i, k, j] = found[1][i, c, j]
            for i in range(3):
                into[2][i, k] = found[2][i, c]
            k += 1


@in_place
def closing_of(num):
    """As of `Closing`."""
    return num[col.CLOSED], num[col.SHALLOW], num[col.THETA] * num[col.STEP], num[col.UNTIL]


@in_place
def pose(num, masses, begin, last, met, rows, w, own, place, slides, b):
    """The problem of the step: the size of H, the norm of b, and its validity.

    begin = (contacts where the step begins, its bodies), last = (keys, forces, states) of what acted last, rows as of
    `free.meet`.
    """
    n, nc = masses[0].size, place.size
    (names, points, _), old = begin
    x, R = col.vectors(w, col.LOOKED_THERE, n), col.rotations(w, col.LOOKED_THERE + 3, n)
    return free.meet(
        masses,
        (met[0][4], met[0][2], met[0][3], met[1][0], met[1][1], met[2][0], x, R),
        (
            names[4],
            points[0],
            points[1],
            col.vectors(old, col.X, n),
            col.vectors(old, col.LINEAR, n),
            col.vectors(old, col.ANGULAR, n),
            col.column(w, col.REACH, n),
        ),
        (col.velocity(old, col.V, n), col.velocity(w, col.V_THERE, n), col.velocity(w, col.V_FREE, n)),
        (last[0], last[1], num[col.STEP], last[2]),
        (met[2][1], met[2][2], closing_of(num)),
        rows,
        (own[: col.ALONE * nc].reshape((5, 3 * nc)), col.column(own, col.FORESEEN, nc), place, slides, b),
    )


@kernel
def strikes(num, met, local, rate, w):
    """Whether any contact met strikes, as of `nsdyn.stepping.collisions.striking`, should its gap close."""
    (names, points, scalars), n = met, rate.size // 6
    rates, where = np.empty((2, n, 3)), (names[2], names[3], points[0], points[1], col.vectors(w, col.X, n))
    motion.twists(col.rotations(w, col.R_THERE, n), rate, n, rates[0], rates[1])
    for c in range(names.shape[1]):
        if scalars[2, c] > 0.0 and local[1, 3 * c] < 0.0:
            weight, bounces_of = touching.weight_of(c, where, (rates[0], rates[1])), (num[col.HALF], num[col.LEAST])
            resting = num[col.TOL] + sight.rests_of(weight, scalars[2, c], bounces_of) / scalars[2, c]
            if local[0, 3 * c] < -resting:
                return True
    return False


@in_place
def lasting(num, met, begin, acted, warm, own, flags, was, b):
    """What persists, into the flags, as of `persistence.persists`, and the problem with that, if it has other gaps.

    begin = (keys, gaps), acted = (keys, pairs), warm = (keys, pairs, states). What contacts were goes into was (nc,).
    Returns whether the problem is valid.
    """
    nc, none = was.size, own[:0]
    local, end_gap, late = (
        own[: col.ALONE * nc].reshape((5, 3 * nc)),
        col.column(own, col.FORESEEN, nc),
        col.column(own, col.LATE, nc),
    )
    slides, stays, sticks = flags[col.SLIDES, :nc], flags[col.STAYS, :nc], flags[col.STICKS, :nc]
    late[:] = 0.0
    before, limits = (begin[0], begin[1], num[col.CLOSED], num[col.STEP]), (none, slides[:0])
    if persistence.persists(acted, warm, before, limits, local, end_gap, False, (stays, sticks, was)):
        law.offsets(local, (end_gap, met[2][2], none, late, closing_of(num)), stays, slides, b)
        return _blocks.size_of(b, met[2][1])[1]
    return True


@kernel
def too_wide(num, blocks):
    """Whether an island has more coordinates than are solved here."""
    return num[col.OWN] == 0.0 or widest(blocks, np.empty(blocks[1].shape[0], np.int64))[0] > int(num[col.DENSE])


@in_place
def rests(num, n, blocks, met, scales, flags, label, a, w, own, out):
    """Whether a solve is all it takes, since nothing turns, nor slips otherwise than foreseen; then it is made."""
    nc, mu, h = scales.size, met[2][1], num[col.STEP]
    v, v_free, change = col.velocity(w, col.V_THERE, n), col.velocity(w, col.V_FREE, n), col.velocity(w, col.CHANGE, n)
    mean, local, slides = (
        col.velocity(w, col.V_MEAN, n),
        own[: col.ALONE * nc].reshape((5, 3 * nc)),
        flags[col.SLIDES, :nc],
    )
    r, u, b = a[col.IMPULSE * nc : col.U * nc], a[col.U * nc : col.FREE * nc], a[col.FREE * nc : col.U_END * nc]
    copy(v_free, col.velocity(w, col.V_TURNED, n))
    change[:] = 0.0
    if nc == 0:
        return True
    if num[col.OWN] == 0.0 or persistence.turns(v, n, h):
        return False
    copy(local[4], r)
    limits = int(num[col.DENSE]), num[col.PENALTY], int(num[col.MAX_ITER]), int(num[col.FEW])
    islands = own[col.ISLANDS * nc : (col.ISLANDS + 3) * nc].reshape((3, nc))
    given = blocks, b, mu, scales, r, u, label, islands, num[col.ENOUGH], num[col.GOOD], limits
    _, left, count, top, residual = by_factors(*given)
    error, before = top / out[col.NORM], flags[col.OTHER, :nc]
    copy(slides, before)
    if left or not (error <= num[col.TOL] and residual <= num[col.TOL]):
        return False
    if law.reconsider(r, u, b, mu, local, slides, False):
        copy(before, slides)
        return False
    _blocks.velocity_change(blocks, r, change)
    for i in range(mean.size):
        mean[i] = 0.5 * (v[i] + v_free[i] + change[i])
    out[col.COUNT], out[col.ERROR], out[col.RESIDUAL] = count, error, residual
    return not persistence.turns(mean, n, h)


@kernel
def respond(num, bodies, blocks, met, scales, flags, again, a, w, own, head, out):
    """Impulses, and couples with which contacts that persist do no work; `DONE`, `SOLVE` or `OTHERWISE`.

    From the gaps that they are found to end with, if those were corrected; `again` where Python has solved the problem.
    bodies = (inverse_J, arm).
    """
    (inverse_J, arm), nc, none = bodies, scales.size, own[:0]
    n, mu, laws_of = arm.size, met[2][1], met[2][2]
    v, v_free, turned = (
        col.velocity(w, col.V_THERE, n),
        col.velocity(w, col.V_FREE, n),
        col.velocity(w, col.V_TURNED, n),
    )
    local, alone = (
        own[: col.ALONE * nc].reshape((5, 3 * nc)),
        own[col.ALONE * nc : col.FORESEEN * nc].reshape((5, 3 * nc)),
    )
    end_gap, late = col.column(own, col.FORESEEN, nc), col.column(own, col.LATE, nc)
    slides, stays, off = flags[col.SLIDES, :nc], flags[col.STAYS, :nc], flags[col.OFF, :nc]
    couple, dv, change = col.vectors(a, col.COUPLE, nc), col.velocity(w, col.TURN, n), col.velocity(w, col.CHANGE, n)
    r, u, b = a[col.IMPULSE * nc : col.U * nc], a[col.U * nc : col.FREE * nc], a[col.FREE * nc : col.U_END * nc]
    mean = col.velocity(w, col.V_MEAN, n)
    laws, first = (end_gap, laws_of, none, late, closing_of(num)), head[col.GAPS_LEFT] == law.GAPS
    kept_r, kept_u, left_over = r, u, col.column(own, col.LEFT_OVER, nc)
    left_over[:] = np.inf
    if again:
        if law.reconsider(r, u, b, mu, local, slides, False):
            return OTHERWISE
        _blocks.velocity_change(blocks, r, change)
    else:
        if not first:
            kept_r, kept_u = r.copy(), u.copy()
        for k in range(5):
            copy(alone[k], local[k])
        if head[col.TURNED]:
            _blocks.relative_velocity(blocks, dv, u)
            for i in range(u.size):
                local[2, i] += u[i]
        if not first:
            law.offsets(local, laws, stays, slides, b)
        copy(local[4], r)
    passes = PASSES if stays.any() else 0
    limits = int(num[col.DENSE]), num[col.PENALTY], int(num[col.MAX_ITER]), int(num[col.FEW])
    code, left, _, solved, error, residual, count = workless(
        blocks,
        (met[0][0], met[0][1], met[0][2], met[0][3], met[1][1]),
        (v, v_free),
        (col.rotations(w, col.R_THERE, n), inverse_J, arm, num[col.STEP]),
        (mu, scales, alone, kept_r, kept_u),
        (stays, flags[col.STICKS, :nc], slides),
        laws,
        off[:0] if first else off,
        (num[col.OWN] > 0.0, num[col.ENOUGH], num[col.GOOD], limits, num[col.TOL], SOLVES),
        (not again, False, passes),
        (couple, dv, change, mean, left_over, flags[col.OTHER, :nc], local, b, r, u),
    )
    if code == UNSOLVED:
        return SOLVE if first and solved == 0 and not again else OTHERWISE
    if solved > 0:
        out[col.COUNT], out[col.ERROR], out[col.RESIDUAL] = count, error, residual
    if left < passes:
        head[col.TURNED] = 1
    if head[col.TURNED]:
        R, works = col.rotations(w, col.R_THERE, n), col.column(own, col.COUPLE_WORK, nc)
        persistence.works(met[0][2], met[0][3], n, R, mean, couple, works)
        for i in range(turned.size):
            turned[i] = v_free[i] + dv[i]
    norm, _ = _blocks.size_of(b, mu)
    out[col.NORM] = norm if norm > 0.0 else 1.0
    return DONE


@in_place
def arrive(num, bodies, arm, f, w):
    """The second half of a step; whether contacts are those where the impulses acted."""
    n = arm.size
    return free.end(
        col.velocity(w, col.V_TURNED, n),
        col.velocity(w, col.CHANGE, n),
        bodies,
        (col.vectors(w, col.X, n), col.quaternions(w, col.QUATERNION, n)),
        num[col.THETA] * num[col.STEP],
        (col.placed(w, col.LOOKED_THERE, n), col.column(w, col.NEAR, n), arm, num[col.STILL]),
        (
            col.velocity(w, col.V_PLUS, n),
            col.vectors(f, col.X, n),
            col.quaternions(f, col.QUATERNION, n),
            col.velocity(f, col.V, n),
            col.rotations(f, col.R, n),
            col.vectors(f, col.LINEAR, n),
            col.vectors(f, col.ANGULAR, n),
        ),
    )


@in_place
def end_gaps(geoms, met, now, f, n, gap):
    """Gaps of the contacts met where the step ends, as of `Detector.gaps`, into gap (nc,)."""
    (names, points, _), (found, _, scalars) = met, now
    if not keys.kept(names[4], found[4], scalars[0], gap):
        keys.gaps(
            fields_of(geoms),
            (col.vectors(f, col.X, n), col.rotations(f, col.R, n)),
            room_of(geoms),
            (names[0], names[1], points[1], names[4]),
            (found[0], found[1], found[4], scalars[0]),
            gap,
        )


@kernel
def corrects(num, met, now, flags, gap, r, n, f, own):
    """Whether contacts that persist end with gaps that are to be closed, as of `Encounter.corrected`."""
    nc, (names, points, _) = gap.size, now
    stays, off, alone = (
        flags[col.STAYS, :nc],
        flags[col.OFF, :nc],
        own[col.ALONE * nc : col.FORESEEN * nc].reshape((5, 3 * nc)),
    )
    if not law.off(gap, r, stays, num[col.CLOSED], off):
        return False
    parts, twists = np.empty(names.shape[1]), (col.vectors(f, col.LINEAR, n), col.vectors(f, col.ANGULAR, n))
    touching.approach((names[2], names[3], points[0], points[1], col.vectors(f, col.X, n)), twists, parts)
    ended, sizes = (names[4], parts, parts[:0]), (num[col.THETA] * num[col.STEP], num[col.CLOSED])
    end_gap, late = col.column(own, col.FORESEEN, nc), col.column(own, col.LATE, nc)
    if not law.end_otherwise(off, gap, met[0][4], ended, alone, sizes, end_gap, late):
        return False
    copy(r, alone[4])
    return True


@kernel
def turns_round(r, u, b, mu, local, was):
    """Whether any slip ends, or turns round, as of `reversal.ending`."""
    return reversal.ending(r, u, b, mu, local, was, np.empty(0, np.bool_), np.empty(was.size, np.int8)) > 0


@in_place
def eventless(num, inscribed, met, now, flags, a, was, spins, own):
    """Whether nothing has turned round, got deep, arrived or turned far on the way, as `passage` asks.

    spins: angular velocities of the bodies, (n, 3), at both ends. What was is overwritten by what presses.
    """
    nc, (names, _, scalars) = was.size, met
    local, stays = own[: col.ALONE * nc].reshape((5, 3 * nc)), flags[col.STAYS, :nc]
    r, u, b = a[col.IMPULSE * nc : col.U * nc], a[col.U * nc : col.FREE * nc], a[col.FREE * nc : col.U_END * nc]
    deepest, deep = least(now[2][0]), min(num[col.CLOSED], num[col.SLOW])
    if deepest < -num[col.CLOSED] or turns_round(r, u, b, scalars[1], local, was):
        return False
    if deepest < -deep:
        # Of what is so deep all is to be pressed.
        gap, more = col.column(a, col.GAP_END, nc), 0
        for c in range(now[2].shape[1]):
            more += now[2][0, c] < -deep
        for c in range(nc):
            more -= r[3 * c] > 0.0 and gap[c] < -deep
        if more > 0:
            return False
    end_gap, far, fastest = col.column(own, col.FORESEEN, nc), flags[col.OFF, :nc], 0.0
    for c in range(nc):
        radius = min(inscribed[names[0, c]], inscribed[names[1, c]])
        if not stays[c] and end_gap[c] > num[col.THETA] * num[col.DEPTH] * radius:
            return False
        was[c] = r[3 * c] > 0.0
    most = law.TURNS / (num[col.THETA] * num[col.STEP])
    for spin in spins:
        for k in range(spin.shape[0]):
            fastest = max(fastest, spin[k, 0] ** 2 + spin[k, 1] ** 2 + spin[k, 2] ** 2)
    if fastest > most * most:
        touching.turns_far((names[2], names[3], scalars[0], was, num[col.CLOSED]), spins, most, far)
        for c in range(nc):
            if far[c]:
                return False
    return True


@in_place
def may_gain(mass, works, fallen):
    """Whether contacts add any energy that matters to that of any body, at the velocity `fallen` gravity gives it."""
    most, slowest = 0.0, np.inf
    for work in works:
        for c in range(work.size):
            most += max(0.0, work[c])
    for k in range(mass.size):
        i = 6 * k
        slowest = min(slowest, 0.5 * mass[k] * (fallen[i] ** 2 + fallen[i + 1] ** 2 + fallen[i + 2] ** 2))
    return most > SURELY * GAIN * slowest


@kernel
def gains(num, bodies, blocks, met, flags, status, works, velocities):
    """Whether contacts that persist, and those that could only take energy, add too much to that of any island.

    works = (normal, friction), velocities: those that the step begins with, and that gravity gives in it.
    """
    (mass, J), nc, (normal, friction) = bodies, status.size, works
    added, label = np.zeros((2, nc)), np.empty(nc, np.int64)
    found = _blocks.islands(blocks[1], blocks[0].size - 1, label)
    for c in range(nc):
        nothing = normal[c] if flags[col.STAYS, c] else 0.0
        if flags[col.STICKS, c] and status[c] == 1:
            nothing += friction[c]
        added[0, label[c]] += nothing
        added[1, label[c]] += normal[c] + friction[c] - nothing
    if num[col.ELASTIC] == 0.0:
        for k in range(found):
            added[0, k] += max(0.0, added[1, k])
    energies, counted = np.zeros((2, found)), np.zeros(mass.size, np.bool_)
    for c in range(nc):
        for s in range(2):
            k = met[0][2 + s, c]
            if k >= 0 and not counted[k]:
                counted[k] = True
                for j in range(2):
                    v, i, twice = velocities[j], 6 * k, 0.0
                    for l in range(3):
                        twice += mass[k] * v[i + l] * v[i + l]
                        for m in range(3):
                            twice += v[i + 3 + l] * J[k, l, m] * v[i + 3 + m]
                    energies[j, label[c]] += 0.5 * twice
    for k in range(found):
        if added[0, k] > SURELY * GAIN * max(energies[0, k], energies[1, k]):
            return True
    return False


@in_place
def book(num, bodies, blocks, met, frame, flags, direction, scales, head, status, f, w, own, acted):
    """What the step did: works, states, forces, energies and the certificate."""
    mass, J, gravity, no_load, none = bodies
    n, nc, out, h = mass.size, status.size, f, num[col.STEP]
    b, mu, r = f[col.RESULTS :], met[2][1], acted[col.IMPULSE * nc : col.U * nc]
    v, v_plus = col.velocity(w, col.V_THERE, n), col.velocity(w, col.V_PLUS, n)
    couples = col.column(own, col.COUPLE_WORK, nc) if head[col.TURNED] else none
    out[col.EXTERNAL], beyond, out[col.NORMAL], out[col.FRICTION], rest = _account.account(
        (mass, gravity, no_load, no_load),
        (h, num[col.THETA]),
        (v, v, v_plus),
        (blocks, none, mu, own[: col.ALONE * nc].reshape((5, 3 * nc)), frame),
        r,
        (flags[col.STAYS], flags[col.STICKS], couples, none),
        num[col.TOL],
        (
            status,
            col.column(acted, col.NORMAL_WORK, nc),
            col.column(acted, col.FRICTION_WORK, nc),
            acted[col.U_END * nc : (col.U_END + 3) * nc],
            col.vectors(acted, col.FORCE, nc),
        ),
    )
    out[col.NUMERICS] = beyond + rest
    x, v_end = col.vectors(b, col.X, n), col.velocity(b, col.V, n)
    out[col.KINETIC], out[col.POTENTIAL] = motion.free_energies(mass, J, gravity, x, v_end)
    projected = own[col.PROJECTED * nc : (col.PROJECTED + 3) * nc]
    outside, gap, shift, speed, step, total, square = certificate_of(
        blocks, acted[col.U * nc : col.FREE * nc], r, mu, scales, direction, projected
    )
    certified = not outside and math.isfinite(gap + shift) and step <= num[col.WEAK] * speed
    out[col.CERTIFIED], out[col.GAP], out[col.SHIFT], out[col.BOUND], out[col.COULOMB] = 0.0, gap, shift, np.inf, np.nan
    if certified:
        half = 0.5 * step * math.sqrt(square)
        out[col.CERTIFIED], out[col.BOUND] = 1.0, half + math.sqrt(half * half + total)


@in_place
def quiet(system, detection, old, begun, new, rooms, next_key, direction, barred, work, stage, ready, asks, step):
    """A move, or a whole step that is to meet no event, or as far as it goes without Python.

    Parameters
    ----------
    system : tuple
        The packed arrays (floats, integers).
    detection : tuple
        What `search` takes first: geoms, pairs, most points of a pair, tolerance.
    old, new : tuple
        States: floats; keys, then pairs of shapes of the contacts that acted; what these were, of int8. The latter with
        room for so many contacts.
    begun : tuple
        What was found where the move begins, with rows of W: floats, integers.
    rooms : tuple
        Room, or none until something moves, for what is found where its impulses act, what it meets of that if not
        all, and what is found where it ends.
    next_key : int
    direction : ndarray
        On which the last certificate rests.
    barred : ndarray of int
        Pairs of shapes that are left alone where they are open, as of `nsdyn.stepping.move.trial`.
    work : tuple
        Room: floats, integers, flags (FLAGS, nc).
    stage : int
        `DONE` to begin with, then how the last call ended.
    ready : bool
        Whether Python has placed the geoms, and asked Coal of the pairs.
    asks : bool
        Whether Coal is asked of any pair.
    step : bool
        Whether it is a step, whose works and certificate are told. Of a move it is left to see what it runs into.

    Returns
    -------
    int
        `DONE`, `OTHERWISE`, `LOOK`, `SOLVE`, `LOOK_AHEAD` or `MORE`.
    """
    (sf, si), (f, keys_of, states), (f_old, acted_old, status_old), (w, whole, flags) = system, new, old, work
    num, arm, nowhere = numbers(sf, si, col.NUMBERS), numbers(sf, si, col.ARM), numbers(sf, si, col.NOWHERE)
    n, room, was, out, head = arm.size, states.size, status_old.size, f, whole[: col.HEAD]
    moments, axes = triples(sf, si, col.MOMENTS), matrices(sf, si, col.AXES)
    inverse_mass, inverse_J = numbers(sf, si, col.INVERSE_MASS), matrices(sf, si, col.INVERSE_J)
    bodies = moments, axes, inverse_mass, inverse_J, numbers(sf, si, col.RADIUS)
    mass, gravity, no_load = numbers(sf, si, col.MASS), numbers(sf, si, col.GRAVITY), triples(sf, si, col.NO_LOAD)
    masses = (
        indices(si, col.BLOCK_OF_FRAME, col.SYSTEM),
        indices(si, col.OFFSET, col.SYSTEM),
        indices(si, col.M_START, col.SYSTEM),
        numbers(sf, si, col.M),
        numbers(sf, si, col.MINV),
    )
    begin, bodies_at, inscribed = col.RESULTS, col.RESULTS + col.BODY * n, numbers(sf, si, col.INSCRIBED)
    b, b_old, a, own = f[begin:bodies_at], f_old[begin:bodies_at], f[bodies_at:], w[col.BODY_WORK * n :]
    first, warm = col.contacts(begun, begun[1].size // col.FOUND_NAMES), (acted_old[:was], acted_old[was:], status_old)

    if stage == DONE:
        if step and strikes_at_once(num, first, warm, b_old, n):
            return OTHERWISE
        far, same = depart(num, bodies, (gravity, no_load, num[col.WEIGHT]), arm, b_old, b, w)
        if step and num[col.ELASTIC] > 0.0 and rebounds(num, first, b_old, w, n):
            return OTHERWISE
        out[col.WENT], out[col.GOES], out[col.TIME] = 0.0 if same else 1.0, 0.0, 0.0
        head[col.MIDDLE], head[col.KEY_MIDDLE], head[col.FAST] = first[0].shape[1], next_key, far > num[col.FASTEST]
        reach, near = col.column(w, col.REACH, n), col.column(w, col.NEAR, n)
        for k in range(n):
            near[k] = 2.0 * reach[k] if barred.size else nowhere[k]
        there, looked = (
            (col.vectors(w, col.X, n), col.rotations(w, col.R_THERE, n), reach),
            col.placed(w, col.LOOKED_THERE, n),
        )
        touching.look(col.placed(b_old, col.LOOKED, n), there, arm, num[col.STILL], looked)
        if not same and asks:
            return LOOK
    starts = stage == DONE or stage == LOOK
    if starts and out[col.WENT] > 0.0:
        looked = col.placed(w, col.LOOKED_THERE, n)
        code = look(detection, ready, looked, first, next_key, rooms[0], head, col.MIDDLE, room)
        if code != DONE:
            return code
    met_of = begun
    if out[col.WENT] > 0.0:
        met_of = rooms[0]
    found = col.contacts(met_of, head[col.MIDDLE])
    if starts:
        head[col.MET], head[col.SOME], head[col.NEEDED] = found[0].shape[1], 0, found[0].shape[1]
        if num[col.ELASTIC] > 0.0 or not touching.all_known(found[0][4], first[0][4], first[2][0], num[col.CLOSED]):
            kept = flags[col.OFF, : head[col.MET]]
            head[col.MET] = catch(num, (arm, inscribed), first, found, warm, b_old, w, barred, kept)
            if head[col.MET] < found[0].shape[1]:
                if col.FOUND * head[col.MET] > rooms[1][0].size:
                    return MORE
                take(found, kept, col.contacts(rooms[1], head[col.MET]))
                rooms[1][1][col.FOUND_NAMES * head[col.MET] + col.MADE], head[col.SOME] = 0, 1
    nc = head[col.MET]
    if head[col.SOME]:
        met_of = rooms[1]
    met, (frame, block, start, H, scales, made) = col.contacts(met_of, nc), col.rows(met_of, nc)
    r, q = a[col.IMPULSE * nc : col.U * nc], a[col.FREE * nc : col.U_END * nc]
    gap, status, acted = col.column(a, col.GAP_END, nc), states[:nc], (keys_of[:nc], keys_of[nc : 2 * nc])
    if starts:
        pressed = warm[0], col.vectors(f_old[bodies_at:], col.FORCE, was), status_old
        of = frame, block, start, H[: made[col.SIZE]] if made[col.MADE] else H, scales, made[col.MADE] > 0
        slides, place = flags[col.SLIDES, :nc], whole[col.HEAD : col.HEAD + nc]
        made[col.SIZE], _, good = pose(num, masses, (first, b_old), pressed, met, of, w, own, place, slides, q)
        made[col.MADE] = 1
        for c in range(nc):
            acted[0][c], acted[1][c] = met[0][4, c], met[0][0, c] * int(num[col.GEOMS]) + met[0][1, c]
        if not good or not lasting(num, met, (first[0][4], first[2][0]), acted, warm, own, flags, status, q):
            return OTHERWISE
        local, rate = own[: col.ALONE * nc].reshape((5, 3 * nc)), col.velocity(b, col.RATE, n)
        if num[col.ELASTIC] > 0.0 and strikes(num, met, local, rate, w):
            return OTHERWISE
        copy(own[: col.ALONE * nc], own[col.ALONE * nc : col.FORESEEN * nc])
        a[col.COUPLE * nc : (col.COUPLE + 3) * nc] = 0.0
        col.velocity(w, col.TURN, n)[:] = 0.0
        head[col.GAPS_LEFT], head[col.TURNED] = law.GAPS, 0
        out[col.COUNT], out[col.ERROR], out[col.RESIDUAL] = 0.0, 0.0, 0.0
        norm, _ = _blocks.size_of(q, met[2][1])
        out[col.NORM] = norm if norm > 0.0 else 1.0
    blocks, now = (masses[1], block, start, H[: made[col.SIZE]], *masses[2:]), found
    if starts and not step and too_wide(num, blocks):
        return OTHERWISE
    while True:
        if stage != LOOK_AHEAD:
            began = seconds(head[col.CLOCK :])
            label, again = whole[col.HEAD + room : col.HEAD + room + nc], stage == SOLVE
            if not starts or not rests(num, n, blocks, met, scales, flags, label, a, w, own, out):
                code = respond(num, (inverse_J, arm), blocks, met, scales, flags, again, a, w, own, head, out)
                if code != DONE:
                    return code
            out[col.TIME] += seconds(head[col.CLOCK :]) - began
            same = arrive(num, bodies, arm, b, w)
            out[col.GOES] = 0.0 if same else 1.0
            there = col.vectors(b, col.X, n), col.rotations(b, col.R, n), col.column(w, col.NEAR, n)
            looked = col.placed(b, col.LOOKED, n)
            touching.look(col.placed(w, col.LOOKED_THERE, n), there, arm, num[col.STILL], looked)
            if not same and asks:
                return LOOK_AHEAD
        now = found
        if out[col.GOES] > 0.0:
            placed, looked = ready and stage == LOOK_AHEAD, col.placed(b, col.LOOKED, n)
            code = look(detection, placed, looked, found, head[col.KEY_MIDDLE], rooms[2], head, col.END, room)
            if code != DONE:
                return LOOK_AHEAD if code == LOOK else code
            now = col.contacts(rooms[2], head[col.END])
            end_gaps(detection[0], met, now, b, n, gap)
        else:
            copy(met[2][0], gap)
        if head[col.GAPS_LEFT] == 0 or not corrects(num, met, now, flags, gap, r, n, b, own):
            break
        head[col.GAPS_LEFT], stage, starts = head[col.GAPS_LEFT] - 1, DONE, False
    if not step:
        return DONE
    spins = col.vectors(b_old, col.ANGULAR, n), col.vectors(b, col.ANGULAR, n)
    if not eventless(num, inscribed, met, now, flags, a, status, spins, own):
        return OTHERWISE
    inertia = mass, matrices(sf, si, col.INERTIA), gravity, no_load, nowhere[:0]
    book(num, inertia, blocks, met, frame, flags, direction, scales, head, status, f, w, own, a)
    works, fallen = (
        (col.column(a, col.NORMAL_WORK, nc), col.column(a, col.FRICTION_WORK, nc)),
        col.velocity(w, col.CHANGE, n),
    )
    rate = col.velocity(b, col.RATE, n)
    for i in range(fallen.size):
        fallen[i] = num[col.STEP] * rate[i]
    velocities = col.velocity(b_old, col.V, n), fallen
    if may_gain(mass, works, fallen) and gains(num, inertia[:2], blocks, met, flags, status, works, velocities):
        return OTHERWISE
    return DONE
