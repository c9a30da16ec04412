"""A step that meets no event, its stages in a row in one call: of free bodies, and of trees but for their motion.

Each stage is made of the kernels that the general step of `nsdyn.stepping.move` calls, so that both give the same bits.
"""

from nsdyn._kernels.clock import seconds
from nsdyn._kernels.compiled import in_place
from nsdyn._kernels.packing import indices, matrices, numbers, triples
from nsdyn._kernels.problem import blocks as _blocks
from nsdyn._kernels.problem.paradox import suspect
from nsdyn._kernels.reductions import copy
from nsdyn._kernels.stepping import columns as col
from nsdyn._kernels.stepping import free, law, touching
from nsdyn._kernels.stepping.quiet_checks import book, eventless, gains, may_gain, rebounds, strikes_at_once
from nsdyn._kernels.stepping.quiet_meeting import (
    DONE,
    EVENT,
    LOOK,
    LOOK_AHEAD,
    MORE,
    MOVE,
    OTHERWISE,
    SOLVE,
    catch,
    lasting,
    look,
    pose,
    strikes,
    take,
)
from nsdyn._kernels.stepping.quiet_response import (
    AGAIN,
    arrive,
    corrects,
    end_gaps,
    first_solve,
    push,
    respond,
    too_wide,
)


@in_place
def depart(num, size, bodies, movers, forces, arm, old, f, w):
    """The first half of a move: how far it reaches, and whether contacts are those where it begins.

    It may be given: Python makes its motion where there are trees, and under the forces of the user.
    """
    n, reach = size[0], col.column(w, col.REACH, size[0])
    there = (
        col.vectors(w, col.X, n),
        col.quaternions(w, col.QUATERNION, n),
        col.velocity(w, col.V_THERE, size),
        col.rotations(w, col.R_THERE, n),
    )
    rate, v_free, looked = (
        col.velocity(f, col.RATE, size),
        col.velocity(w, col.V_FREE, size),
        col.placed(old, col.LOOKED, n),
    )
    if num[col.GIVEN] > 0.0:
        return free.given(
            movers,
            (bodies[4], num[col.WEIGHT]),
            (there[0], there[3], there[2], v_free),
            num[col.STEP],
            num[col.THETA],
            looked,
            (arm, num[col.STILL]),
            (rate, reach),
        )
    return free.half(
        bodies,
        forces,
        (col.vectors(old, col.X, n), col.quaternions(old, col.QUATERNION, n), col.velocity(old, col.V, size)),
        num[col.STEP],
        num[col.THETA],
        looked,
        (arm, num[col.STILL]),
        (*there, v_free, rate, reach),
    )


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
        `DONE`, `OTHERWISE`, `LOOK`, `SOLVE`, `LOOK_AHEAD`, `MORE`, `MOVE` or `EVENT`.
    """
    (sf, si), (f, keys_of, states), (f_old, acted_old, status_old), (w, whole, flags) = system, new, old, work
    num, arm, nowhere = numbers(sf, si, col.NUMBERS), numbers(sf, si, col.ARM), numbers(sf, si, col.NOWHERE)
    mass, J = numbers(sf, si, col.MASS), matrices(sf, si, col.INERTIA)
    offset = indices(si, col.OFFSET, col.SYSTEM)
    size = arm.size, offset[offset.size - 1], mass.size
    scene = num, size
    n, room, was, out, head = arm.size, states.size, status_old.size, f, whole[: col.HEAD]
    table, support = indices(si, col.TREES, col.SYSTEM), indices(si, col.SUPPORT, col.SYSTEM)
    movers, trees = (mass.size, (table, support, numbers(sf, si, col.JACOBIAN))), table.size > 0
    movers_begun = mass.size, (table, support, numbers(sf, si, col.BEGUN))
    moments, axes = triples(sf, si, col.MOMENTS), matrices(sf, si, col.AXES)
    inverse_mass, inverse_J = numbers(sf, si, col.INVERSE_MASS), matrices(sf, si, col.INVERSE_J)
    bodies = moments, axes, inverse_mass, inverse_J, numbers(sf, si, col.RADIUS)
    gravity, force, torque = numbers(sf, si, col.GRAVITY), triples(sf, si, col.PUSH), triples(sf, si, col.TWIST)
    masses = (
        indices(si, col.BLOCK_OF_FRAME, col.SYSTEM),
        offset,
        indices(si, col.M_START, col.SYSTEM),
        numbers(sf, si, col.M),
        numbers(sf, si, col.MINV),
    )
    begin, last = col.RESULTS, col.RESULTS + col.FRAME * n + col.COORDINATE * size[1]
    inscribed, wide = numbers(sf, si, col.INSCRIBED), int(num[col.WIDE])
    b, b_old, a, own = (
        f[begin:last],
        f_old[begin:last],
        f[last:],
        w[col.FRAME_WORK * n + col.COORDINATE_WORK * size[1] :],
    )
    first, warm = col.contacts(begun, begun[1].size // col.FOUND_NAMES), (acted_old[:was], acted_old[was:], status_old)

    if stage == DONE:
        if step and strikes_at_once(num, first, warm, b_old, n):
            return OTHERWISE
        far, same = depart(num, size, bodies, movers, (gravity, force, num[col.WEIGHT]), arm, b_old, b, w)
        if step and num[col.ELASTIC] > 0.0 and rebounds(scene, movers_begun, first, b_old, w):
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
    starts, work_room = stage == DONE or stage == LOOK, (f, w, own, a)
    if starts and out[col.WENT] > 0.0:
        looked = col.placed(w, col.LOOKED_THERE, n)
        code = look(detection, ready, looked, (first, next_key), rooms[0], head, col.MIDDLE, (room, wide))
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
            moved = movers_begun, movers, inscribed
            head[col.MET] = catch(scene, moved, (first, found), warm, b_old, w, barred, kept)
            if head[col.MET] < found[0].shape[1]:
                if (col.ROWS + wide) * head[col.MET] > rooms[1][0].size:
                    return MORE
                take(found, kept, col.contacts(rooms[1], head[col.MET]))
                rooms[1][1][col.FOUND_NAMES * head[col.MET] + col.MADE], head[col.SOME] = 0, 1
    nc = head[col.MET]
    if head[col.SOME]:
        met_of = rooms[1]
    met, (frame, block, start, H, scales, made) = col.contacts(met_of, nc), col.rows(met_of, nc)
    q = a[col.FREE * nc : col.U_END * nc]
    gap, status, acted = col.column(a, col.GAP_END, nc), states[:nc], (keys_of[:nc], keys_of[nc : 2 * nc])
    if starts:
        pressed = warm[0], col.vectors(f_old[last:], col.FORCE, was), status_old
        of = frame, block, start, H[: made[col.SIZE]] if made[col.MADE] else H, scales, made[col.MADE] > 0
        slides, place = flags[col.SLIDES, :nc], whole[col.HEAD : col.HEAD + nc]
        made[col.SIZE], _, good = pose(
            scene, (masses, movers), (first, b_old), pressed, met, of, (w, own), (place, slides, q)
        )
        made[col.MADE] = 1
        for c in range(nc):
            acted[0][c], acted[1][c] = met[0][4, c], met[0][0, c] * int(num[col.GEOMS]) + met[0][1, c]
        if not good or not lasting(num, met, ((first[0][4], first[2][0]), acted, warm), own, flags, status, q):
            return OTHERWISE
        local, rate = own[: col.ALONE * nc].reshape((5, 3 * nc)), col.velocity(b, col.RATE, size)
        end_gap = col.column(own, col.FORESEEN, nc)
        if num[col.ELASTIC] > 0.0 and strikes(num, n, movers, met, local, end_gap, rate, w):
            return OTHERWISE
        copy(own[: col.ALONE * nc], own[col.ALONE * nc : col.FORESEEN * nc])
        a[col.COUPLE * nc : (col.COUPLE + 3) * nc] = 0.0
        col.velocity(w, col.TURN, size)[:] = 0.0
        head[col.GAPS_LEFT], head[col.TURNED], head[col.SOLVED] = law.GAPS, 0, 0
        out[col.COUNT], out[col.ERROR], out[col.RESIDUAL] = 0.0, 0.0, 0.0
        norm, _ = _blocks.size_of(q, met[2][1])
        out[col.NORM] = norm if norm > 0.0 else 1.0
    blocks, now = (offset, block, start, H[: made[col.SIZE]], *masses[2:]), found
    of_rows = blocks, frame, scales
    if starts and not step and too_wide(num, blocks):
        return OTHERWISE
    while True:
        if stage != LOOK_AHEAD:
            if stage != MOVE:
                began = seconds(head[col.CLOCK :])
                code = AGAIN if stage == SOLVE else SOLVE
                if starts:
                    label = whole[col.HEAD + room : col.HEAD + room + nc]
                    code = first_solve(scene, of_rows, met, flags, label, work_room)
                    if code == SOLVE:
                        return SOLVE
                if code != DONE:
                    code = respond(scene, (inverse_J, arm), of_rows, met, flags, code, head, work_room)
                    if code != DONE:
                        return code
                out[col.TIME] += seconds(head[col.CLOCK :]) - began
                if trees:
                    push(size, blocks, a[col.IMPULSE * nc : col.U * nc], w)
                    return MOVE
                arrive(num, size, bodies, b, w)
            there = col.vectors(b, col.X, n), col.rotations(b, col.R, n), col.column(w, col.NEAR, n)
            same = touching.unmoved(col.placed(w, col.LOOKED_THERE, n), there, arm, num[col.STILL])
            out[col.GOES] = 0.0 if same else 1.0
            looked = col.placed(b, col.LOOKED, n)
            touching.look(col.placed(w, col.LOOKED_THERE, n), there, arm, num[col.STILL], looked)
            if not same and asks:
                return LOOK_AHEAD
        now = found
        if out[col.GOES] > 0.0:
            placed, looked = ready and stage == LOOK_AHEAD, col.placed(b, col.LOOKED, n)
            code = look(detection, placed, looked, (found, head[col.KEY_MIDDLE]), rooms[2], head, col.END, (room, wide))
            if code != DONE:
                return LOOK_AHEAD if code == LOOK else code
            now = col.contacts(rooms[2], head[col.END])
            end_gaps(detection[0], met, now, b, n, gap)
        else:
            copy(met[2][0], gap)
        if head[col.GAPS_LEFT] == 0 or not corrects(num, n, met, now, flags, work_room):
            break
        head[col.GAPS_LEFT], stage, starts = head[col.GAPS_LEFT] - 1, DONE, False
    if not step:
        return DONE
    spins = col.vectors(b_old, col.ANGULAR, n), col.vectors(b, col.ANGULAR, n)
    if not eventless(num, inscribed, met, now, flags, status, spins, work_room):
        return EVENT
    inertia = mass, J, gravity, force, torque, nowhere[:0]
    book(scene, inertia, of_rows, met, flags, direction, head, status, work_room)
    out[col.SUSPECT] = 0.0
    if nc > 0 and num[col.FEWEST] >= 0.0:
        r, u = a[col.IMPULSE * nc : col.U * nc], a[col.U * nc : col.FREE * nc]
        out[col.SUSPECT] = suspect(blocks, met[2][1], q, u, r, int(num[col.FEWEST]))
    if trees:
        return DONE
    works, fallen = (
        (col.column(a, col.NORMAL_WORK, nc), col.column(a, col.FRICTION_WORK, nc)),
        col.velocity(w, col.CHANGE, size),
    )
    rate = col.velocity(b, col.RATE, size)
    for i in range(fallen.size):
        fallen[i] = num[col.STEP] * rate[i]
    velocities = col.velocity(b_old, col.V, size), fallen
    if may_gain(mass, works, fallen) and gains(num, inertia[:2], blocks, met, flags, status, works, velocities):
        return OTHERWISE
    return DONE
