"""Checks whether a move is an eventless step, and the results of such a step, in the arrays of `columns`."""

import math

import numpy as np

from nsdyn._kernels.compiled import kernel, no_alloc
from nsdyn._kernels.dynamics import motion
from nsdyn._kernels.problem import blocks as _blocks
from nsdyn._kernels.problem.gauss import certificate_of
from nsdyn._kernels.reductions import least
from nsdyn._kernels.stepping import columns as col
from nsdyn._kernels.stepping import law, slip_end, touching
from nsdyn._kernels.stepping.active_set import overrun, rests_of
from nsdyn._kernels.stepping.eventless_contacts import all_rates
from nsdyn._kernels.stepping.islands import located
from nsdyn._kernels.stepping.options import OPTIONS
from nsdyn._kernels.vectors import square

GAIN, DEEP = OPTIONS.gain, OPTIONS.depth_captured

SURELY = 0.5
"""Fraction of `GAIN` that the contacts of one connected group may add. Then those of any larger island add less than
`GAIN`: its energy, at the velocity of all bodies or at the velocity that gravity gives them, is at least half the sum
of the energies of its groups."""


@no_alloc
def strikes_at_once(num, active, last, old, n):
    """Whether closed contacts strike at the start of the step; last = (keys, pairs, states) of the last active set."""
    x, twists = col.vectors(old, col.X, n), col.twists(old, n)
    least_speed = touching.striking_speed(active, x, twists, last, int(num[col.GEOMS]), num[col.GAP_TOL])
    return least_speed < -num[col.LEAST_PENETRATION] / num[col.STEP]


@kernel
def rebounds(scene, movers, active, old, w):
    """Whether a closed elastic contact approaches or separates at the start of the step too fast to rest.

    scene = (numbers, size), movers as in `opened` at the beginning.
    """
    (num, size), n, (names, _, scalars) = scene, scene[1][0], active
    v, v_free, x = col.velocity(old, col.V, size), col.velocity(w, col.V_FREE, size), col.vectors(old, col.X, n)
    rates, twists = all_rates(movers, col.poses(old, n), v, v_free, num[col.STEP]), col.twists(old, n)
    for c in range(names.shape[1]):
        e = scalars[2, c]
        if e > 0.0 and scalars[0, c] <= num[col.GAP_TOL]:
            weight, u = touching.weight_of(c, active, x, rates), touching.approach_of(c, active, x, twists)
            rests = rests_of(weight, e, (num[col.HALF], num[col.LEAST]))
            if u > num[col.TOL] + rests or u < -(num[col.TOL] + rests / e):
                return True
    return False


@kernel
def any_end(solution, mu, local, was, active, first, node):
    """Whether any slip ends, as in `slip_end.ending`, in an island whose events are located.

    solution = (r, u, b), first: contacts at the beginning of the move, which determine the islands; `node` of every
    frame.
    """
    ends = np.empty(was.size, np.bool_)
    if not slip_end.ending(*solution, mu, local, was, np.empty(0, np.bool_), ends):
        return False
    seen = np.zeros(node.max() + 2, np.bool_)  # The last one: what has no node.
    located(node, first[2:4], seen[:-1])
    for c in range(was.size):
        for s in range(2):
            if ends[c] and seen[node[active[2 + s, c]]]:
                return True
    return False


@no_alloc
def eventless(num, bodies, contacts, last, flags, was, room):
    """Whether the move has no event: no slip that ends, no deep overlap, no impact, no contact that turns far.

    Nor is there a contact whose normal does not separate its bodies, as in `active_set.overrun`. bodies = (geoms, radii
    of balls inside the shapes, nodes of the frames), contacts = (active set, those found at the end, those at the
    beginning), last = (keys, states) of the last active set.
    """
    (geoms, inscribed, node), (active, now, first) = bodies, contacts
    nc, n, (names, _, scalars), (f, w, own, a) = was.size, node.size - 1, active, room
    local, stays = col.local(own, col.LOCAL, nc), flags[col.STAYS, :nc]
    answer = r, _, _ = col.answer(a, nc)
    deepest, deep = least(now[2][0]), min(num[col.GAP_TOL], num[col.LEAST_PENETRATION])
    if deepest < -num[col.GAP_TOL] or any_end(answer, scalars[1], local, was, names, first[0], node):
        return False
    if deepest < -deep:
        # Every contact this deep must have an impulse.
        gap, more = col.column(a, col.GAP_END, nc), 0
        for c in range(now[2].shape[1]):
            more += now[2][0, c] < -deep
        for c in range(nc):
            more -= r[3 * c] > 0.0 and gap[c] < -deep
        if more > 0:
            return False
    end_gap, presses, far = col.column(own, col.FORESEEN, nc), flags[col.OTHER, :nc], flags[col.OFF, :nc]
    for c in range(nc):
        radius = min(inscribed[names[0, c]], inscribed[names[1, c]])
        presses[c] = r[3 * c] > 0.0
        if presses[c] and not stays[c] and end_gap[c] > num[col.THETA] * num[col.DEPTH] * radius:
            return False
    ends = (col.poses(w, n), active), (col.poses(f[col.RESULTS :], n), now)
    if overrun(geoms, active, col.rotations(w, col.R, n), ends, last, presses, (inscribed, DEEP), far):
        return False
    for c in range(nc):
        if flags[col.LEVER, c] and (presses[c] or scalars[0, c] <= num[col.GAP_TOL]):
            return False
    return True


@no_alloc
def may_gain(mass, works, fallen):
    """Whether contact works could exceed the bound of `gains`, for any body at the velocity `fallen` due to gravity."""
    most, slowest = 0.0, np.inf
    for work in works:
        for c in range(work.size):
            most += max(0.0, work[c])
    for k in range(mass.size):
        i = 6 * k
        slowest = min(slowest, 0.5 * mass[k] * (square(fallen[i]) + square(fallen[i + 1]) + square(fallen[i + 2])))
    return most > SURELY * GAIN * slowest


@no_alloc
def gained(label, states, works, restitution, out):
    """Energy that the contacts of every island add by errors of the motion, into out[0]; out is (2, islands), zero.

    It is the work of persistent contacts, and of others the sum if it is positive: those only take energy. Not so in
    islands with contacts that rebound. states = (states of contacts, stays, sticks), works = (normal, friction), all
    (nc,), as `label` and `restitution`.
    """
    (status, stays, sticks), (normal, friction) = states, works
    for c in range(status.size):
        nothing = normal[c] if stays[c] else 0.0
        if sticks[c] and status[c] == law.STICK:
            nothing += friction[c]
        out[0, label[c]] += nothing
        out[1, label[c]] += normal[c] + friction[c] - nothing
        if restitution[c] > 0.0:
            out[1, label[c]] = -np.inf
    for k in range(out.shape[1]):
        out[0, k] += max(0.0, out[1, k])


@kernel
def gains(bodies, blocks, active, flags, status, works, velocities):
    """Whether persistent contacts, and contacts that may only dissipate, add too much energy to any island.

    Islands with trees are not checked: trees keep their own errors small. works = (normal, friction), velocities =
    (those at the beginning of the step, those that gravity gives in the step).
    """
    (mass, J), nc, label = bodies, status.size, np.empty(status.size, np.int64)
    found = _blocks.islands(blocks[1], blocks[0].size - 1, label)
    added = np.zeros((2, found))
    gained(label, (status, flags[col.STAYS], flags[col.STICKS]), works, active[2][2], added)
    energies, counted = np.zeros((2, found)), np.zeros(mass.size, np.bool_)
    for c in range(nc):
        for s in range(2):
            k = active[0][2 + s, c]
            if k >= mass.size:
                energies[0, label[c]] = np.inf
            elif k >= 0 and not counted[k]:
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


@no_alloc
def book(scene, bodies, rows, active, flags, direction, head, status, room):
    """Store the results of a step: works, states, forces, energies and the certificate.

    Parameters
    ----------
    scene : (numbers, size)
    bodies : tuple
        mass, inertia, gravity, and an empty array.
    rows : (blocks, frame, scales)
    active : tuple
        The contacts.
    flags : ndarray of bool, shape (FLAGS, nc)
    direction : ndarray
        Slater direction of the last certificate.
    head : ndarray of int
    status : ndarray of int8, shape (nc,)
        States of the contacts in the last move, replaced by those of this step.
    room : tuple
        The state, the work array, the work columns of the contacts, and the columns of their impulses and works.
    """
    (num, size), (mass, J, gravity, none) = scene, bodies
    (blocks, frame, scales), (f, w, own, acted) = rows, room
    n, nc, out, h = size[0], status.size, f, num[col.STEP]
    b, mu, r = f[col.RESULTS :], active[2][1], acted[col.IMPULSE * nc : col.U * nc]
    v, v_plus = col.velocity(w, col.V_THERE, size), col.velocity(w, col.V_PLUS, size)
    couples = col.column(own, col.COUPLE_WORK, nc) if head[col.TURNED] else none
    beyond, out[col.NORMAL], out[col.FRICTION], rest = law.contact_works(
        (mass, gravity),
        (h, num[col.THETA]),
        (v, v, v_plus),
        (blocks, none, mu, col.local(own, col.LOCAL, nc), frame),
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
    out[col.EXTERNAL] = out[col.DAMPING] = out[col.CONSTRAINT] = 0.0
    out[col.NUMERICS] = beyond + rest
    x, v_end = col.vectors(b, col.X, n), col.velocity(b, col.V, size)
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
