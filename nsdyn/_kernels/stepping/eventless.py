"""An eventless step of free bodies and trees in one kernel call; only the motion of trees is left to Python.

Each stage consists of the kernels that the general step of `nsdyn.stepping.move` calls: both give the same bits.
"""

import numpy as np

from nsdyn._kernels.clock import seconds
from nsdyn._kernels.compiled import kernel, no_alloc
from nsdyn._kernels.dynamics import links, motion
from nsdyn._kernels.dynamics.rotation import flow
from nsdyn._kernels.problem import blocks as _blocks
from nsdyn._kernels.problem.paradox import suspect
from nsdyn._kernels.reductions import copy, most
from nsdyn._kernels.stepping import columns as col
from nsdyn._kernels.stepping import law, touching
from nsdyn._kernels.stepping.eventless_checks import book, eventless, gains, may_gain, rebounds, strikes_at_once
from nsdyn._kernels.stepping.eventless_contacts import (
    DETECT,
    DETECT_AHEAD,
    DONE,
    EVENT,
    MORE,
    MOVE,
    OTHERWISE,
    SOLVE,
    capture,
    detect,
    gap_rule_of,
    strikes,
    take,
)
from nsdyn._kernels.stepping.eventless_response import AGAIN, arrive, changes, end_gaps, impulses, too_wide
from nsdyn._kernels.stepping.persistence import persists
from nsdyn._kernels.stepping.solving import PASSES


@kernel(inline="always")
def depart(s, old, f, w):
    """Compute the first half of a move; return the largest distance that points may move in the second half, m.

    With trees, and under forces of the user, Python has already computed the motion. s is the result of
    `columns.opened`, here and in the functions below.
    """
    (num, size), (radii, _, _, _), _, bodies, (gravity, load), _, (free, trees), _ = s
    n, h, theta, (moments, axes, inverse_mass, inverse_J) = size[0], num[col.STEP], num[col.THETA], bodies
    (x, R), reach, rate = col.poses(w, n), col.column(w, col.REACH, n), col.velocity(f, col.RATE, size)
    v, v_free = col.velocity(w, col.V_THERE, size), col.velocity(w, col.V_FREE, size)
    if num[col.GIVEN] == 0.0:
        begin = col.vectors(old, col.X, n), col.quaternions(old, col.QUATERNION, n), col.velocity(old, col.V, size)
        flow(moments, axes, *begin, (1.0 - theta) * h, x, col.quaternions(w, col.QUATERNION, n), v)
        motion.rotations(col.quaternions(w, col.QUATERNION, n), R)
        motion.accelerate(inverse_mass, inverse_J, gravity, load, load, h, v, v_free)
    for i in range(rate.size):
        rate[i] = (v_free[i] - v[i]) / h
    ahead, fallen = theta * h, theta * h * h * num[col.WEIGHT]
    motion.reach(v_free, ahead, fallen, radii[:free], reach)
    if free < n:
        links.reach(trees, x, v_free, ahead, radii[free:], fallen, reach[free:])
    return most(reach)


@kernel(inline="always")
def set_out(s, first, warm, next_key, located, asks, step, room):
    """`depart`, and the poses for detection at the midpoint: `DONE`, `DETECT`, or `OTHERWISE` for an impact at once.

    first = contacts where the move begins, warm = (keys, pairs, states) of the contacts that acted last; room = (old
    state, results, state, work array, integers).
    """
    (num, size), (radii, nowhere, _, _), _, _, _, _, _, movers_begun = s
    (b_old, out, b, w, head), n = room, size[0]
    if step and strikes_at_once(num, first, warm, b_old, n):
        return OTHERWISE
    far = depart(s, b_old, b, w)
    if step and num[col.ELASTIC] > 0.0 and rebounds(s[0], movers_begun, first, b_old, w):
        return OTHERWISE
    head[col.MIDDLE], head[col.KEY_MIDDLE], head[col.FAST] = first[0].shape[1], next_key, far > num[col.FASTEST]
    reach, near = col.column(w, col.REACH, n), col.column(w, col.NEAR, n)
    for k in range(n):
        near[k] = 2.0 * reach[k] if located.size else nowhere[k]
    there = *col.poses(w, n), reach
    detected_at = col.placed(b_old, col.DETECTED_AT, n)
    same = touching.detection_pose(detected_at, there, radii, num[col.STILL], col.placed(w, col.DETECTED_THERE, n))
    out[col.WENT], out[col.GOES], out[col.TIME] = 0.0 if same else 1.0, 0.0, 0.0
    return DETECT if asks and not same else DONE


@kernel(inline="always")
def meet(s, contacts, warm, rooms, flags, located, room):
    """Select the active set of a move: `DONE`, or `MORE` if the memory is too small.

    contacts = (those where the move begins, those found at the midpoint). The active set is copied only if it is not
    all found contacts. rooms = (memory for the active set, most numbers per contact), room = (old state, work array,
    integers).
    """
    scene, (_, _, inscribed, _), _, _, _, _, movers, movers_begun = s
    num, (first, found), (into, wide), (b_old, w, head) = scene[0], contacts, rooms, room
    nc = found[0].shape[1]
    head[col.ACTIVE], head[col.SOME], head[col.NEEDED] = nc, 0, nc
    kept = flags[col.OFF, :nc]
    if num[col.ELASTIC] == 0.0 and touching.known(found[0][4], first[0][4], first[2][0], num[col.GAP_TOL], kept):
        return DONE
    head[col.ACTIVE] = capture(scene, (movers_begun, movers, inscribed), contacts, warm, b_old, w, located, kept)
    if head[col.ACTIVE] < nc:
        if wide * head[col.ACTIVE] > into[0].size:
            return MORE
        take(found, kept, col.contacts(into, head[col.ACTIVE]))
        into[1][col.FOUND_NAMES * head[col.ACTIVE] + col.MADE], head[col.SOME] = 0, 1
    return DONE


@kernel(inline="always")
def seen(s, detection, stage, move, last, rooms, flags, room):
    """Find the contacts at the midpoint and select the active set: `DONE`, or the code of the work that is missing.

    stage = (stage, ready), move = (next_key, located, asks, step), last = (contacts where the move begins, warm), rooms
    = (memory for found contacts, memory for the active set, (most contacts, most numbers per contact)), room as in
    `set_out`.
    """
    (now, ready), (next_key, located, asks, step), (begun, warm), (all_found, some, most) = stage, move, last, rooms
    (b_old, out, _, w, head), first = room, col.contacts(begun, begun[1].size // col.FOUND_NAMES)
    if now == DONE:
        code = set_out(s, first, warm, next_key, located, asks, step, room)
        if code != DONE:
            return code
    found_in = begun
    if out[col.WENT] > 0.0:
        detected_at, found_in = col.placed(w, col.DETECTED_THERE, s[0][1][0]), all_found
        code = detect(detection, ready, detected_at, (first, next_key), all_found, head, col.MIDDLE, most)
        if code != DONE:
            return code
    found = col.contacts(found_in, head[col.MIDDLE])
    return meet(s, (first, found), warm, (some, most[1]), flags, located, (b_old, w, head))


@kernel(inline="always")
def posed(s, first, last, active, rows, acted, flags, room):
    """Pose the contact problem of the move: `DONE`, or `OTHERWISE` if it is out of range, or if a contact strikes.

    Contacts that no motion opens or closes are out of range, too. Slip, couples and end gaps are first as foreseen.
    last = (warm, forces of the contacts that acted last), acted = (keys, pairs, states) of the active set, room = (old
    state, results, columns of the active set, work array, work columns of the contacts, places, integers). Factors of W
    that are computed already belong to the same contacts and are reused.
    """
    (num, size), (_, _, _, rounding), _, _, _, masses, (free_bodies, trees), _ = s
    (warm, force), (frame, block, start, H, scales, made), (names, _, scalars) = last, rows, active
    (b_old, out, a, w, own, place, head), (keys, pairs, was), nc, n = room, acted, acted[2].size, size[0]
    b, q, none, (node, offset, m_start, m, minv) = out[col.RESULTS :], a[col.FREE * nc :], own[:0], masses
    q, x, again = q[: 3 * nc], col.vectors(w, col.DETECTED_THERE, n), made[col.MADE] > 0
    if not again:
        made[col.SIZE] = motion.contact_layout(active, node, offset, frame, block, start)
        if free_bodies < n:
            H[: made[col.SIZE]] = 0.0
        motion.free_rows(active, frame, x, col.rotations(w, col.DETECTED_THERE + 3, n), free_bodies, start, H)
        links.rows(trees, active, frame, start, H)
    blocks = (offset, block, start, H[: made[col.SIZE]], m_start, m, minv)
    if not again:
        _blocks.delassus_scales(blocks, num[col.GAP_TOL], scalars[0], scales)
        made[col.MADE] = 1
    if not _blocks.in_range(scales):
        return OTHERWISE
    local, end_gap = col.local(own, col.LOCAL, nc), col.column(own, col.FORESEEN, nc)
    excess_speed = col.column(own, col.EXCESS_SPEED, nc)
    sliding, stays, sticks = flags[col.SLIDES, :nc], flags[col.STAYS, :nc], flags[col.STICKS, :nc]
    twists, gap_rule = col.twists(b_old, n), gap_rule_of(num)
    reach = col.column(w, col.REACH, n), num[col.GAP_TOL], rounding, free_bodies
    law.local_velocities(
        blocks,
        (col.velocity(b_old, col.V, size), col.velocity(w, col.V_THERE, size), col.velocity(w, col.V_FREE, size)),
        (active[1][0][:0], none, none, none),
        (first, col.vectors(b_old, col.X, n), twists, reach),
        (active, frame, x),
        (warm[0], force, num[col.STEP]),
        gap_rule[2],
        (local, end_gap, place, flags[col.LEVER, :nc]),
    )
    law.predict_sliding(blocks, scalars[1], place, warm[2], local, sliding)
    excess_speed[:], geoms = 0.0, int(num[col.GEOMS])
    begin = first, none, (num[col.GAP_TOL], num[col.STEP], gap_rule[2])
    for c in range(nc):
        keys[c], pairs[c] = names[4, c], names[0, c] * geoms + names[1, c]
    persists(names, geoms, warm, begin, (none, sliding[:0]), local, end_gap, False, (stays, sticks, was))
    law.offsets(local, (end_gap, scalars[2], sliding[:0], excess_speed, gap_rule), stays, sliding, q)
    norm, good = _blocks.size_of(q, scalars[1])
    if not good:
        return OTHERWISE
    rate = col.velocity(b, col.RATE, size)
    if num[col.ELASTIC] > 0.0 and strikes(num, n, (free_bodies, trees), active, local, end_gap, rate, w):
        return OTHERWISE
    copy(own[: col.ALONE * nc], own[col.ALONE * nc : col.FORESEEN * nc])
    a[col.COUPLE * nc : (col.COUPLE + 3) * nc] = 0.0
    col.velocity(w, col.TURN, size)[:] = 0.0
    head[col.PASSES_LEFT], head[col.AGAIN], head[col.TURNED], head[col.SOLVED] = PASSES, 0, 0, 0
    col.column(own, col.LEFT_OVER, nc)[:] = np.inf
    out[col.COUNT], out[col.ERROR], out[col.RESIDUAL], out[col.NORM] = 0.0, 0.0, 0.0, norm if norm > 0.0 else 1.0
    return DONE


@kernel(inline="always")
def solved(s, rows, active, flags, known, label, head, room):
    """Solve for the impulses and move to the end; returns a code; `known` as in `impulses`.

    `DONE`: the free bodies are at the end of the move. `MOVE`: Python has to move the trees there. `SOLVE`: Python has
    to solve the problem.
    """
    scene, _, _, bodies, _, _, movers, _ = s
    (num, size), nc, (out, w, _, a) = scene, active[0].shape[1], room
    began = seconds(head[col.CLOCK :])
    if impulses(scene, rows, active, flags, known, label, head, room) == SOLVE:
        return SOLVE
    out[col.TIME] += seconds(head[col.CLOCK :]) - began
    v_turned, v_plus = col.velocity(w, col.V_TURNED, size), col.velocity(w, col.V_PLUS, size)
    change = col.velocity(w, col.CHANGE, size)
    for i in range(v_plus.size):
        v_plus[i] = v_turned[i] + change[i]
    if movers[1][0].size > 0:
        _blocks.momentum(rows[0], a[col.IMPULSE * nc : col.U * nc], col.velocity(w, col.PUSHED, size))
        return MOVE
    arrive(num, size, bodies, out[col.RESULTS :], w)
    return DONE


@kernel(inline="always")
def goes(s, b, w, out):
    """Whether the end of the move needs a new detection after that at the midpoint; sets the poses for it."""
    (num, size), (radii, _, _, _) = s[0], s[1]
    n = size[0]
    there = *col.poses(b, n), col.column(w, col.NEAR, n)
    detected_at = col.placed(w, col.DETECTED_THERE, n)
    same = touching.detection_pose(detected_at, there, radii, num[col.STILL], col.placed(b, col.DETECTED_AT, n))
    out[col.GOES] = 0.0 if same else 1.0
    return out[col.GOES] > 0.0


@kernel(inline="always")
def told(s, rows, contacts, begun, flags, status, head, room):
    """Store the results of a step without an event: `DONE`, `EVENT`, or `OTHERWISE` if contacts add too much energy.

    contacts = (geoms, active set, contacts found at the end), begun = (old state, keys and states of the last active
    set, contacts at the beginning, Slater direction of the last certificate).
    """
    scene, (_, nowhere, inscribed, _), inertia, _, (gravity, _), masses, _, _ = s
    (num, size), (out, w, _, a), nc = scene, room, status.size
    (geoms, active, now), (b_old, last, first, direction) = contacts, begun
    b = out[col.RESULTS :]
    shapes, met = (geoms, inscribed, masses[0]), (active, now, first)
    if not eventless(num, shapes, met, last, flags, status, room):
        return EVENT
    book(scene, (*inertia, gravity, nowhere[:0]), rows, active, flags, direction, head, status, room)
    out[col.SUSPECT] = 0.0
    if nc > 0 and num[col.FEWEST] >= 0.0:
        r, u, q = col.answer(a, nc)
        out[col.SUSPECT] = suspect(rows[0], active[2][1], q, u, r, int(num[col.FEWEST]))
    works = col.column(a, col.NORMAL_WORK, nc), col.column(a, col.FRICTION_WORK, nc)
    fallen, rate = col.velocity(w, col.CHANGE, size), col.velocity(b, col.RATE, size)
    for i in range(fallen.size):
        fallen[i] = num[col.STEP] * rate[i]
    velocities = col.velocity(b_old, col.V, size), fallen
    if may_gain(inertia[0], works, fallen) and gains(inertia, rows[0], active, flags, status, works, velocities):
        return OTHERWISE
    return DONE


@no_alloc
def eventless_step(system, detection, old, begun, new, rooms, next_key, direction, located, work, call):
    """Compute a move, or an eventless step, up to the next work that only Python can do.

    Parameters
    ----------
    system : tuple
        The packed arrays (floats, integers).
    detection : tuple
        Geoms, pairs, most points of a pair, tolerance, as `seek` and `gather` take them.
    old, new : tuple
        States: floats; keys, then pairs of shapes of the active set; states of its contacts, int8. `new` has memory for
        as many contacts as its int8 array has entries.
    begun : tuple
        Contacts found where the move begins, with factors of W: floats, integers.
    rooms : tuple
        Memory, or none until a frame moves, for contacts found at the midpoint, for the active set if it is not all of
        these, and for contacts found at the end.
    next_key : int
    direction : ndarray
        Slater direction of the last certificate.
    located : ndarray of int
        Pairs of shapes that get no impulse where they are open, as in `nsdyn.stepping.move.try_move`.
    work : tuple
        Work arrays: floats, integers, flags (FLAGS, nc).
    call : tuple
        An int and bools: `DONE` in the first call, then the code of the last call; whether Python has placed the geoms
        and computed Coal's pairs; whether any pair needs Coal; and whether this is a step, whose works and certificate
        are stored. After a move the caller checks for missed contacts.
    """
    s, (out, keys_of, states), (f_old, acted_old, status_old), (w, whole, flags) = col.opened(system), new, old, work
    stage, ready, asks, step = call
    (num, size), masses = s[0], s[5]
    n, room, was, head, wide = size[0], states.size, status_old.size, whole[: col.HEAD], col.ROWS + int(num[col.WIDE])
    last = col.RESULTS + col.FRAME * n + col.COORDINATE * size[1]
    b, b_old, a = out[col.RESULTS : last], f_old[col.RESULTS : last], out[last:]
    own = w[col.FRAME_WORK * n + col.COORDINATE_WORK * size[1] :]
    first, warm = col.contacts(begun, begun[1].size // col.FOUND_NAMES), (acted_old[:was], acted_old[was:], status_old)
    starts, work_room = stage == DONE or stage == DETECT, (out, w, own, a)

    if starts:
        move, into = (next_key, located, asks, step), (rooms[0], rooms[1], (room, wide))
        code = seen(s, detection, (stage, ready), move, (begun, warm), into, flags, (b_old, out, b, w, head))
        if code != DONE:
            return code
    met_of = begun
    if out[col.WENT] > 0.0:
        met_of = rooms[0]
    found = col.contacts(met_of, head[col.MIDDLE])
    nc = head[col.ACTIVE]
    if head[col.SOME]:
        met_of = rooms[1]
    active, (frame, block, start, H, scales, made) = col.contacts(met_of, nc), col.rows(met_of, nc)
    gap, acted = col.column(a, col.GAP_END, nc), (keys_of[:nc], keys_of[nc : 2 * nc], states[:nc])
    if starts:
        before, place = (warm, col.vectors(f_old[last:], col.FORCE, was)), whole[col.HEAD : col.HEAD + nc]
        of_rows = frame, block, start, H, scales, made
        code = posed(s, first, before, active, of_rows, acted, flags, (b_old, out, a, w, own, place, head))
        if code != DONE:
            return code
    blocks, now = (masses[1], block, start, H[: made[col.SIZE]], *masses[2:]), found
    rows, label = (blocks, frame, scales), whole[col.HEAD + room : col.HEAD + room + nc]
    if starts and not step and too_wide(num, blocks):
        return OTHERWISE
    known = DONE if starts else SOLVE
    while True:
        if stage != DETECT_AHEAD:
            if stage != MOVE:
                code = solved(s, rows, active, flags, known, label, head, work_room)
                if code != DONE:
                    return code
            if goes(s, b, w, out) and asks:
                return DETECT_AHEAD
        now = found
        if out[col.GOES] > 0.0:
            placed, pose = ready and stage == DETECT_AHEAD, col.placed(b, col.DETECTED_AT, n)
            code = detect(detection, placed, pose, (found, head[col.KEY_MIDDLE]), rooms[2], head, col.END, (room, wide))
            if code != DONE:
                return DETECT_AHEAD if code == DETECT else code
            now = col.contacts(rooms[2], head[col.END])
            end_gaps(detection[0], active, now, b, n, gap)
        else:
            copy(active[2][0], gap)
        if not changes(s[0], (s[3][3], s[1][0]), rows, active, now, flags, head, work_room):
            break
        stage, known = DONE, AGAIN
    met, before = (detection[0], active, now), (b_old, (warm[0], warm[2]), first, direction)
    return told(s, rows, met, before, flags, acted[2], head, work_room) if step else DONE
