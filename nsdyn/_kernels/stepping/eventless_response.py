"""Contact impulses of a move, its end, and the gaps at the end, in the arrays of `columns`."""

import numpy as np

from nsdyn._kernels.collision import keys
from nsdyn._kernels.collision.search import fields_of, room_of
from nsdyn._kernels.compiled import kernel, no_alloc
from nsdyn._kernels.dynamics import motion
from nsdyn._kernels.dynamics.rotation import flow
from nsdyn._kernels.problem import blocks as _blocks
from nsdyn._kernels.reductions import copy
from nsdyn._kernels.solvers.start import by_factors, widest
from nsdyn._kernels.stepping import columns as col
from nsdyn._kernels.stepping import law, persistence, touching
from nsdyn._kernels.stepping.eventless_contacts import DONE, SOLVE, gap_rule_of
from nsdyn._kernels.stepping.solving import residuals, thaw, update_sliding

AGAIN = -1
"""Code: the problem has been posed anew."""


@kernel
def too_wide(num, blocks):
    """Whether an island has more coordinates than the kernel solves."""
    return num[col.OWN] == 0.0 or widest(blocks, np.empty(blocks[1].shape[0], np.int64))[0] > int(num[col.DENSE])


@kernel
def impulses(scene, rows, active, flags, known, label, head, room):
    """Solve for the impulses of the problem: `DONE`, or `SOLVE` if Python has to.

    `known` is `DONE` for the first problem of a move, `SOLVE` if Python has solved it, `AGAIN` if it was posed anew.
    """
    (num, size), (blocks, _, scales), (out, w, own, a) = scene, rows, room
    nc, mu, change = scales.size, active[2][1], col.velocity(w, col.CHANGE, size)
    local, (r, u, b) = col.local(own, col.LOCAL, nc), col.answer(a, nc)
    if known == DONE:
        copy(col.velocity(w, col.V_FREE, size), col.velocity(w, col.V_TURNED, size))
        change[:] = 0.0
    if nc == 0:
        return DONE
    if known != SOLVE:
        copy(local[4], r)
        if num[col.OWN] == 0.0:
            return SOLVE
        limits = int(num[col.DENSE]), num[col.PENALTY], int(num[col.MAX_ITER])
        islands = own[col.ISLANDS * nc : (col.ISLANDS + 3) * nc].reshape((3, nc))
        given = blocks, b, mu, scales, r, u, local[0], label, islands, num[col.ENOUGH], num[col.GOOD], limits
        _, left, count, top, residual = by_factors(*given)
        error = top / out[col.NORM]
        if left or not (error <= num[col.TOL] and residual <= num[col.TOL]):
            return SOLVE
        out[col.COUNT], out[col.ERROR], out[col.RESIDUAL] = count, error, residual
    if head[col.AGAIN]:
        kept = own[col.KEPT * nc : (col.KEPT + 6) * nc]
        thaw(blocks, flags[col.OFF, :nc], (kept[: 3 * nc], kept[3 * nc :]), (r, u))
    _blocks.respond(blocks, r, np.empty(change.size), change)
    return DONE


@no_alloc
def pose_anew(scene, rows, active, flags, head, room):
    """Pose the problem anew with corrected slip, end gaps and couples; the last impulses are the warm start."""
    (num, size), (blocks, _, _), (out, w, own, a), nc = scene, rows, room, active[0].shape[1]
    alone, local, (r, u, b) = col.local(own, col.ALONE, nc), col.local(own, col.LOCAL, nc), col.answer(a, nc)
    kept, excess_speed = own[col.KEPT * nc : (col.KEPT + 6) * nc], col.column(own, col.EXCESS_SPEED, nc)
    laws = col.column(own, col.FORESEEN, nc), active[2][2], flags[0, :0], excess_speed, gap_rule_of(num)
    copy(r, kept[: 3 * nc])
    copy(u, kept[3 * nc :])
    for k in range(4):
        copy(alone[k], local[k])
    copy(r, local[4])
    if head[col.TURNED]:
        v_free, v = col.velocity(w, col.V_FREE, size), col.velocity(w, col.V_TURNED, size)
        dv = col.velocity(w, col.TURN, size)
        _blocks.relative_velocity(blocks, dv, u)
        for i in range(u.size):
            local[2, i] += u[i]
        for i in range(v.size):
            v[i] = v_free[i] + dv[i]
    law.offsets(local, laws, flags[col.STAYS, :nc], flags[col.SLIDES, :nc], b)
    norm, _ = _blocks.size_of(b, active[2][1])
    out[col.NORM], head[col.AGAIN] = norm if norm > 0.0 else 1.0, 1


@no_alloc
def arrive(num, size, bodies, f, w):
    """Move the free bodies through the second half of a step."""
    n, x, quaternion = size[0], col.vectors(f, col.X, size[0]), col.quaternions(f, col.QUATERNION, size[0])
    there = col.vectors(w, col.X, n), col.quaternions(w, col.QUATERNION, n), col.velocity(w, col.V_PLUS, size)
    v, R = col.velocity(f, col.V, size), col.rotations(f, col.R, n)
    flow(bodies[0], bodies[1], *there, num[col.THETA] * num[col.STEP], x, quaternion, v)
    motion.rotations(quaternion, R)
    motion.twists(R, v, n, *col.twists(f, n))


@no_alloc
def end_gaps(geoms, active, now, f, n, gap):
    """Gaps of the active set at the end of the step, as in `Detector.gaps`, into gap (nc,)."""
    if not keys.kept(active[0][4], now[0][4], now[2][0], gap):
        keys.gaps(fields_of(geoms), col.poses(f, n), room_of(geoms), active, now, gap)


@kernel
def corrects(num, n, active, now, flags, left, room):
    """Whether persistent contacts end with gaps to correct, as in `ContactKinematics.corrected`; corrects them.

    `left` (nc,) are the residuals of the islands of the contacts, m/s.
    """
    (out, _, own, a), nc = room, active[0].shape[1]
    f, gap, r = out[col.RESULTS :], col.column(a, col.GAP_END, nc), a[col.IMPULSE * nc : col.U * nc]
    stays, off, alone = flags[col.STAYS, :nc], flags[col.OFF, :nc], col.local(own, col.ALONE, nc)
    closed = np.maximum(num[col.GAP_TOL], left * num[col.STEP])
    if not law.off(gap, r, stays, closed, off):
        return False
    parts, twists = np.empty(now[0].shape[1]), col.twists(f, n)
    touching.approach(now, col.vectors(f, col.X, n), twists, parts)
    ended, sizes = (now[0][4], parts, parts[:0]), (num[col.THETA] * num[col.STEP], closed)
    end_gap, excess_speed = col.column(own, col.FORESEEN, nc), col.column(own, col.EXCESS_SPEED, nc)
    return law.end_otherwise(off, gap, active[0][4], ended, alone, sizes, end_gap, excess_speed)


@kernel
def changes(scene, bodies, rows, active, now, flags, head, room):
    """Whether the impulses must be solved once more: unforeseen slip, work of persistent contacts, or end gaps.

    scene = (numbers, size), bodies = (inverse_J, arm), now: contacts at the end of the move. If True the problem is
    posed anew; if False the works of couples are stored.
    """
    (num, size), (inverse_J, arm), (blocks, _, scales), (out, w, own, a) = scene, bodies, rows, room
    nc = active[0].shape[1]
    if nc == 0:
        return False
    (r, u, b), local, sliding = col.answer(a, nc), col.local(own, col.LOCAL, nc), flags[col.SLIDES, :nc]
    off, other, slips = flags[col.OFF, :nc], flags[col.OTHER, :nc], np.empty(nc, np.bool_)
    again, solved, some = head[col.AGAIN] > 0, flags[col.OFF, : nc if head[col.AGAIN] > 0 else 0], False
    if head[col.PASSES_LEFT] > 0:
        some = update_sliding(blocks, (r, u, b, active[2][1]), local, sliding, again, solved, slips)
    if not (head[col.TURNED] or some or flags[col.STAYS, :nc].any()):
        return False
    v, v_plus = col.velocity(w, col.V_THERE, size), col.velocity(w, col.V_PLUS, size)
    mean = col.velocity(w, col.V_MEAN, size)
    for i in range(mean.size):
        mean[i] = 0.5 * (v[i] + v_plus[i])
    R, couple = col.rotations(w, col.R, size[0]), col.vectors(a, col.COUPLE, nc)
    left = col.column(own, col.LEFT_OVER, nc)
    if head[col.PASSES_LEFT] > 0:
        errors, enough = np.empty(nc), min(num[col.ENOUGH], num[col.GAP_TOL] / num[col.STEP])
        residuals(blocks, (scales, active[2][1]), (r, u), out[col.RESIDUAL], enough, errors)
        if persistence.turn(
            blocks,
            active,
            mean,
            (R, inverse_J, arm, num[col.STEP]),
            (r, u, active[2][1], own[:0], np.maximum(num[col.ENOUGH], errors)),
            (flags[col.STAYS, :nc], flags[col.STICKS, :nc], sliding),
            (couple, col.velocity(w, col.TURN, size), left, other),
        ):
            head[col.TURNED], some = 1, True
        some = corrects(num, size[0], active, now, flags, errors, room) or some
        if some:
            for c in range(nc):
                if off[c]:
                    left[c] = np.inf
                off[c] = off[c] or other[c] or slips[c]
            head[col.PASSES_LEFT] -= 1
            pose_anew(scene, rows, active, flags, head, room)
            return True
    if head[col.TURNED]:
        persistence.works(active[0], size[2], R, mean, couple, col.column(own, col.COUPLE_WORK, nc))
    return False
