"""What contacts do in a move, where it then ends, and gaps there, in the arrays of `columns`."""

import numpy as np

from nsdyn._kernels.collision import keys
from nsdyn._kernels.collision.search import fields_of, room_of
from nsdyn._kernels.compiled import in_place, kernel
from nsdyn._kernels.problem import blocks as _blocks
from nsdyn._kernels.reductions import copy
from nsdyn._kernels.solvers.start import by_factors, widest
from nsdyn._kernels.stepping import columns as col
from nsdyn._kernels.stepping import free, law, persistence, touching
from nsdyn._kernels.stepping.quiet_meeting import DONE, OTHERWISE, SOLVE, closing_of
from nsdyn._kernels.stepping.workless import PASSES, SOLVES, reconsider_some, thaw, workless
from nsdyn._kernels.stepping.workless import SOLVE as UNSOLVED

SOLVED, AGAIN = -1, -2
"""A problem is solved here, or by Python, but that may not be all."""


@kernel
def too_wide(num, blocks):
    """Whether an island has more coordinates than are solved here."""
    return num[col.OWN] == 0.0 or widest(blocks, np.empty(blocks[1].shape[0], np.int64))[0] > int(num[col.DENSE])


@in_place
def first_solve(scene, rows, met, flags, label, room):
    """Solve the problem, as foreseen: `DONE` where that is all, `SOLVED` where not, else `SOLVE`.

    It is where nothing turns, nor slips otherwise than foreseen.
    """
    (num, size), (blocks, _, scales), (out, w, own, a) = scene, rows, room
    nc, mu, h = scales.size, met[2][1], num[col.STEP]
    v, v_free, change = (
        col.velocity(w, col.V_THERE, size),
        col.velocity(w, col.V_FREE, size),
        col.velocity(w, col.CHANGE, size),
    )
    mean, local, slides = (
        col.velocity(w, col.V_MEAN, size),
        own[: col.ALONE * nc].reshape((5, 3 * nc)),
        flags[col.SLIDES, :nc],
    )
    r, u, b = a[col.IMPULSE * nc : col.U * nc], a[col.U * nc : col.FREE * nc], a[col.FREE * nc : col.U_END * nc]
    copy(v_free, col.velocity(w, col.V_TURNED, size))
    change[:] = 0.0
    if nc == 0:
        return DONE
    copy(local[4], r)
    if num[col.OWN] == 0.0:
        return SOLVE
    limits = int(num[col.DENSE]), num[col.PENALTY], int(num[col.MAX_ITER])
    islands = own[col.ISLANDS * nc : (col.ISLANDS + 3) * nc].reshape((3, nc))
    given = blocks, b, mu, scales, r, u, local[0], label, islands, num[col.ENOUGH], num[col.GOOD], limits
    _, left, count, top, residual = by_factors(*given)
    error, before = top / out[col.NORM], flags[col.OTHER, :nc]
    if left or not (error <= num[col.TOL] and residual <= num[col.TOL]):
        return SOLVE
    out[col.COUNT], out[col.ERROR], out[col.RESIDUAL] = count, error, residual
    copy(slides, before)
    if law.reconsider((r, u, b, mu), local, slides, False):
        copy(before, slides)
        return SOLVED
    _blocks.velocity_change(blocks, r, change)
    for i in range(mean.size):
        mean[i] = 0.5 * (v[i] + v_free[i] + change[i])
    return SOLVED if persistence.turns(mean, size[2], h) else DONE


@kernel
def slip_otherwise(blocks, solution, laws, kept, flags, head, out):
    """Whether contacts slip otherwise than a solution of Python foresaw; then that is the next problem.

    What the problems before it changed nothing of is as it was `kept`, (r, u); then that is what it is now. solution =
    (r, u, b, mu, local), laws as of `law.offsets`.
    """
    (r, u, b, mu, local), nc, n = solution, solution[3].size, solution[0].size
    slides, changed, solved = flags[col.SLIDES, :nc], flags[col.OTHER, :nc], head[col.SOLVED]
    label = np.empty(nc, np.int64)
    islands = np.ones(_blocks.islands(blocks[1], blocks[0].size - 1, label), np.bool_)
    if solved > 0:
        thaw(label, changed, islands, (kept[:n], kept[n:]), (r, u))
    copy(r, kept[:n])
    copy(u, kept[n:])
    if not reconsider_some((r, u, b, mu), local, slides, solved > 0, label, islands, changed):
        return False
    law.offsets(local, laws, flags[col.STAYS, :nc], slides, b)
    norm, _ = _blocks.size_of(b, mu)
    out[col.NORM] = norm if norm > 0.0 else 1.0
    head[col.SOLVED] += 1
    return True


@kernel
def pose_anew(blocks, solution, alone, laws, dv, flags, head):
    """The problem with the gaps that contacts were found to end with, and what couples add; from the last impulses."""
    (r, u, b, _, local), nc = solution, solution[3].size
    for k in range(5):
        copy(alone[k], local[k])
    if head[col.TURNED]:
        _blocks.relative_velocity(blocks, dv, u)
        for i in range(u.size):
            local[2, i] += u[i]
    law.offsets(local, laws, flags[col.STAYS, :nc], flags[col.SLIDES, :nc], b)
    copy(local[4], r)


@kernel
def respond(scene, bodies, rows, met, flags, known, head, room):
    """Impulses, and couples with which contacts that persist do no work; `DONE`, `SOLVE` or `OTHERWISE`.

    The first problem is `SOLVED`, or solved by Python, `AGAIN`; or it is to be, `SOLVE`, from the gaps that contacts
    were found to end with. scene = (numbers, size), bodies = (inverse_J, arm).
    """
    (num, size), (inverse_J, arm), (blocks, _, scales), (out, w, own, a) = scene, bodies, rows, room
    nc, mu, R = scales.size, met[2][1], col.rotations(w, col.R_THERE, size[0])
    alone = own[col.ALONE * nc : col.FORESEEN * nc].reshape((5, 3 * nc))
    stays, other = flags[col.STAYS, :nc], flags[col.OTHER, :nc]
    couple, dv, change, mean, left_over = (
        col.vectors(a, col.COUPLE, nc),
        col.velocity(w, col.TURN, size),
        col.velocity(w, col.CHANGE, size),
        col.velocity(w, col.V_MEAN, size),
        col.column(own, col.LEFT_OVER, nc),
    )
    r, u, b = a[col.IMPULSE * nc : col.U * nc], a[col.U * nc : col.FREE * nc], a[col.FREE * nc : col.U_END * nc]
    local = own[: col.ALONE * nc].reshape((5, 3 * nc))
    laws = col.column(own, col.FORESEEN, nc), met[2][2], own[:0], col.column(own, col.LATE, nc), closing_of(num)
    solution, last, off = (r, u, b, mu, local), (r, u), flags[col.OFF, :0]
    left_over[:] = np.inf
    if known == AGAIN:
        if slip_otherwise(blocks, solution, laws, own[col.KEPT * nc : (col.KEPT + 6) * nc], flags, head, out):
            return SOLVE if head[col.SOLVED] <= SOLVES else OTHERWISE
        _blocks.velocity_change(blocks, r, change)
    elif known == SOLVE:
        last, off = (r.copy(), u.copy()), flags[col.OFF, :nc]
        pose_anew(blocks, solution, alone, laws, dv, flags, head)
    passes = PASSES if stays.any() else 0
    limits = int(num[col.DENSE]), num[col.PENALTY], int(num[col.MAX_ITER])
    code, left, solved, error, residual, count = workless(
        blocks,
        (met[0][0], met[0][1], met[0][2], met[0][3], met[1][1]),
        (col.velocity(w, col.V_THERE, size), col.velocity(w, col.V_FREE, size)),
        (R, inverse_J, arm, num[col.STEP]),
        (mu, scales, own[:0], alone, *last),
        (stays, flags[col.STICKS, :nc], flags[col.SLIDES, :nc]),
        laws,
        off,
        (num[col.OWN] > 0.0, num[col.ENOUGH], num[col.GOOD], limits, num[col.TOL], SOLVES),
        (known != AGAIN, False, passes, (known == SOLVED, int(out[col.COUNT]), out[col.ERROR], out[col.RESIDUAL])),
        (couple, dv, change, mean, left_over, other, local, b, r, u),
    )
    if code == UNSOLVED:
        return OTHERWISE
    if solved > 0:
        out[col.COUNT], out[col.ERROR], out[col.RESIDUAL] = count, error, residual
    if left < passes:
        head[col.TURNED] = 1
    if head[col.TURNED]:
        persistence.works(met[0][2], met[0][3], size[2], R, mean, couple, col.column(own, col.COUPLE_WORK, nc))
        v_free, turned = col.velocity(w, col.V_FREE, size), col.velocity(w, col.V_TURNED, size)
        for i in range(turned.size):
            turned[i] = v_free[i] + dv[i]
    norm, _ = _blocks.size_of(b, mu)
    out[col.NORM] = norm if norm > 0.0 else 1.0
    return DONE


@in_place
def arrive(num, size, bodies, f, w):
    """The second half of a step of free bodies."""
    n = size[0]
    free.end(
        col.velocity(w, col.V_TURNED, size),
        col.velocity(w, col.CHANGE, size),
        bodies,
        (col.vectors(w, col.X, n), col.quaternions(w, col.QUATERNION, n)),
        num[col.THETA] * num[col.STEP],
        (
            col.velocity(w, col.V_PLUS, size),
            col.vectors(f, col.X, n),
            col.quaternions(f, col.QUATERNION, n),
            col.velocity(f, col.V, size),
            col.rotations(f, col.R, n),
            col.vectors(f, col.LINEAR, n),
            col.vectors(f, col.ANGULAR, n),
        ),
    )


@in_place
def push(size, blocks, r, w):
    """The velocity after the impulses, v⁺ = v_f + M̃⁻¹ H r, and H r."""
    v, change, impulse = (
        col.velocity(w, col.V_TURNED, size),
        col.velocity(w, col.CHANGE, size),
        col.velocity(w, col.PUSHED, size),
    )
    v_plus = col.velocity(w, col.V_PLUS, size)
    for i in range(v.size):
        v_plus[i] = v[i] + change[i]
    _blocks.momentum(blocks, r, impulse)


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
def corrects(num, n, met, now, flags, room):
    """Whether contacts that persist end with gaps that are to be closed, as of `Encounter.corrected`."""
    (out, _, own, a), (names, points, _), nc = room, now, met[0].shape[1]
    f, gap, r = out[col.RESULTS :], col.column(a, col.GAP_END, nc), a[col.IMPULSE * nc : col.U * nc]
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
