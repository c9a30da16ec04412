"""What a step does at its contacts: what it remembers of them, the law of impact, slip to foresee, works.

Rows come first for the contacts, three a contact (N, T1, T2), then for joint limits and joint friction.
"""

import math

import numpy as np
from numba import njit

from nsdyn._kernels.blocks import relative_velocity


@njit(cache=True)
def meet(
    offset, block, start, h, v, v_free, drag, drag_after, press, dt, theta, resting_speed, closed, fast, old_key,
    status, old_normal, velocity, old_turn, impulse, key, frame, found, restitution, rates, guess, turn, slides, gap,
    w, struck,
):  # fmt: skip
    """Relative velocities of a step, `turning`, `warm_start` and `impact_law`.

    The `rates` (4, 3 rows): at v, the same with the rows of the beginning, at v_free with the rows of the end, what the
    rows turn in the step. `drag`, `drag_after` and `press` are empty where there are none. Returns whether any contact
    slides, and what `impact_law` does. The gaps were `found` at the midpoint or, in a `fast` step, at the beginning.
    """
    u_before, u_begin, u_free, bend = rates
    relative_velocity(offset, block, start, h, v, u_before)
    relative_velocity(offset, block, start, h, v_free, u_free)
    for i in range(drag.size):
        u_before[i] += drag[i]
        u_free[i] += drag_after[i]
    for i in range(press.size):
        u_free[i] += press[i]
    place = places(old_key, key)
    warm_start(place, impulse, frame, guess)
    bend[:] = 0.0
    turning(place, status, old_normal, velocity, old_turn, frame, u_before, bend, turn, slides)
    for i in range(bend.size):
        u_begin[i] = u_before[i] - (1.0 - theta) * bend[i]
        u_free[i] += theta * bend[i]
    # Where the gaps were looked for at the beginning they have moved since; else the rows have turned.
    moves, before = (u_begin, (1.0 - theta) * dt) if fast else (bend, -0.5 * (1.0 - theta) ** 2 * dt)
    w[:], struck[:] = 0.0, False
    some, elastic = impact_law(
        u_begin, moves, before, found, restitution, theta * dt, resting_speed, closed, gap, w, struck
    )
    return slides.any(), some, elastic


@njit(cache=True)
def places(old_key, new_key):
    """Where every new key stands among the old ones, -1 where it does not."""
    out = np.full(new_key.size, -1)
    known = 0
    while known < min(old_key.size, new_key.size) and old_key[known] == new_key[known]:
        out[known] = known
        known += 1
    if known < new_key.size:
        order = np.argsort(old_key)
        keys = old_key[order]
        place = np.searchsorted(keys, new_key)
        for c in range(known, new_key.size):
            if place[c] < order.size and keys[place[c]] == new_key[c]:
                out[c] = order[place[c]]
    return out


@njit(cache=True)
def warm_start(place, impulse, frame, r):
    """World impulses of old contacts in the frames of those that continue them, 0 for new ones, into r (3 nc,)."""
    for c in range(place.size):
        for i in range(3):
            r[3 * c + i] = 0.0
            if place[c] >= 0:
                p = impulse[place[c]]
                r[3 * c + i] = frame[c, i, 0] * p[0] + frame[c, i, 1] * p[1] + frame[c, i, 2] * p[2]


@njit(cache=True)
def turning(place, status, old_normal, velocity, old_turn, frame, u, foreseen, turn, slides):
    """Change of relative velocity by the turning of the rows, in a step of the contacts that were not open in the last.

    World axes: turn = Hᵀ v - (what it was with the rows of the last step, turned with the normal by the least
    rotation), 0 for other contacts, into turn (nc, 3). In the contact frames: the shorter of it and the last one where
    their angle is acute, into foreseen (3 nc,), 0 before. Which of them slid, into slides (nc,).
    """
    a = np.empty(3)
    for c in range(place.size):
        for i in range(3):
            turn[c, i] = 0.0
        slides[c] = False
        k = place[c]
        if k < 0 or status[k] == 0:
            continue
        slides[c] = status[k] == 2
        n, m, x = frame[c, 0], old_normal[k], velocity[k]
        cosine = n[0] * m[0] + n[1] * m[1] + n[2] * m[2]
        if cosine <= 0.0:
            continue
        normal = m[0] * x[0] + m[1] * x[1] + m[2] * x[2]
        half = (normal + n[0] * x[0] + n[1] * x[1] + n[2] * x[2]) / (1.0 + cosine)
        along, now, before = 0.0, 0.0, 0.0
        for j in range(3):
            a[j] = frame[c, 0, j] * u[3 * c] + frame[c, 1, j] * u[3 * c + 1] + frame[c, 2, j] * u[3 * c + 2]
            a[j] -= x[j] - half * (n[j] + m[j]) + 2.0 * normal * n[j]
            turn[c, j] = a[j]
            along += a[j] * old_turn[k, j]
            now += a[j] * a[j]
            before += old_turn[k, j] * old_turn[k, j]
        if along <= 0.0:
            continue
        if before < now:
            a[:] = old_turn[k]
        for i in range(3):
            foreseen[3 * c + i] = frame[c, i, 0] * a[0] + frame[c, i, 1] * a[1] + frame[c, i, 2] * a[2]


@njit(cache=True)
def impact_law(u, moves, before, found, restitution, h_theta, resting_speed, closed, gap, w, struck):
    """Gaps at the midpoint and the offsets w with u_N + w_N >= 0 at the end, into gap (nc,) and w (3 rows,).

    The gaps were `found` (nc,), `before` seconds ago if they changed with the speeds `moves`. An impact (e > 0,
    approach faster than resting_speed, closing by the end of the step) gets Newton's law, w_N = e u_N⁻, and is marked
    in `struck`; an open contact may close its gap, w_N = gap / (theta h); one with gap <= closed has w_N = 0. Returns
    whether any contact is struck, and whether any has e > 0.
    """
    some, elastic = False, False
    for c in range(found.size):
        approach = u[3 * c]
        gap[c] = found[c] + before * moves[3 * c]
        elastic = elastic or restitution[c] > 0.0
        struck[c] = restitution[c] > 0.0 and approach < -resting_speed and gap[c] + h_theta * approach <= 0.0
        some = some or struck[c]
        if struck[c]:
            w[3 * c] = restitution[c] * approach
        elif gap[c] > closed:
            w[3 * c] = gap[c] / h_theta
    return some, elastic


@njit(cache=True)
def curve(offset, block, start, h, change, u_begin, u_free, slides, w):
    """Offset that turns the slip which friction opposes from that of the end to that of the middle, into w (3 rows,).

    Half the change of u_T across its direction that the `change` of v makes foresee, of contacts that slide and will
    slide on: those whose slip changes by less than half of itself.
    """
    relative_velocity(offset, block, start, h, change, w)
    w[3 * slides.size :] = 0.0
    for c in range(slides.size):
        i = 3 * c
        x, y = u_free[i + 1] + w[i + 1], u_free[i + 2] + w[i + 2]
        w[i] = w[i + 1] = w[i + 2] = 0.0
        dx, dy = x - u_begin[i + 1], y - u_begin[i + 2]
        slip = u_begin[i + 1] ** 2 + u_begin[i + 2] ** 2
        if slides[c] and dx * dx + dy * dy < 0.25 * slip:
            across = 0.5 * (x * dy - y * dx) / (x * x + y * y)
            w[i + 1] = across * y
            w[i + 2] = -across * x


@njit(cache=True)
def release(r, mu, curve, every, status):
    """0 open (no impulse), 1 stick (impulse inside the cone), 2 slip (on its boundary), into status (nc,).

    The offsets in `curve` (3 rows,), empty for none, of contacts that stick are dropped, or all of them if there are
    any and `every`; tells whether there are any.
    """
    some = False
    for c in range(mu.size):
        t = math.sqrt(r[3 * c + 1] ** 2 + r[3 * c + 2] ** 2)
        if r[3 * c] <= 0.0:
            status[c] = 0
        elif t < mu[c] * r[3 * c] * (1.0 - 1e-9):
            status[c] = 1
            if curve.size and (curve[3 * c + 1] != 0.0 or curve[3 * c + 2] != 0.0):
                curve[3 * c + 1] = curve[3 * c + 2] = 0.0
                some = True
        else:
            status[c] = 2
    if some and every:
        curve[:] = 0.0
    return some


@njit(cache=True)
def contact_works(u_before, u_after, r, normal, friction):
    """Work of every contact impulse, ½ (u⁻ + u⁺)·r split in normal and tangential part, in J; returns their sums."""
    total_normal, total_friction = 0.0, 0.0
    for c in range(normal.size):
        i = 3 * c
        normal[c] = 0.5 * (u_before[i] + u_after[i]) * r[i]
        friction[c] = 0.5 * (
            (u_before[i + 1] + u_after[i + 1]) * r[i + 1] + (u_before[i + 2] + u_after[i + 2]) * r[i + 2]
        )
        total_normal += normal[c]
        total_friction += friction[c]
    return total_normal, total_friction


@njit(cache=True)
def smallest(x):
    """The smallest entry, or 0 if none is negative; NumPy takes ten times as long for few."""
    least = 0.0
    for i in range(x.size):
        least = min(least, x[i])
    return least


@njit(cache=True)
def to_world(frame, x, out):
    """Vectors x (3 rows,) of the contacts in world axes, into out (nc, 3)."""
    for c in range(frame.shape[0]):
        for j in range(3):
            out[c, j] = frame[c, 0, j] * x[3 * c] + frame[c, 1, j] * x[3 * c + 1] + frame[c, 2, j] * x[3 * c + 2]


@njit(cache=True)
def common(change, last_change, push):
    """What two changes (n,) agree on, the smaller of two of one sign and 0 else, into push (n,)."""
    for i in range(change.size):
        push[i] = 0.0
        if change[i] * last_change[i] > 0.0:
            push[i] = change[i] if abs(change[i]) < abs(last_change[i]) else last_change[i]


@njit(cache=True)
def leave(
    offset, block, start, h, v_begin, v_free, change, last_change, drag_after, u_before, bend, gap, frame, r, dt, theta,
    v, v_theta, u, gap_after, normal, friction, impulse, velocity, push,
):  # fmt: skip
    """What a step ends with whose impulses r (3 rows,) change v by `change`; returns the sums of `contact_works`.

    v and θ v + (1 - θ) v_begin; relative velocities with the rows of the end; gaps, linear in the motion; works; in
    world axes impulses, and velocities with the rows of the midpoint; what the two last changes have in `common`.
    """
    for i in range(v.size):
        v[i] = v_free[i] + change[i]
        v_theta[i] = theta * v[i] + (1.0 - theta) * v_begin[i]
    u_after = np.empty(u.size)
    relative_velocity(offset, block, start, h, v, u_after)
    for i in range(drag_after.size):
        u_after[i] += drag_after[i]
    for i in range(u.size):
        u[i] = u_after[i] + theta * bend[i]
    for c in range(gap.size):
        gap_after[c] = gap[c] + theta * dt * u[3 * c]
    to_world(frame, r, impulse)
    to_world(frame, u_after, velocity)
    common(change, last_change, push)
    return contact_works(u_before, u_after, r, normal, friction)
