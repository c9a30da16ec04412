"""What free bodies gained in a step, and the rolling resistance that takes it from their islands."""

import math

import numpy as np

from nsdyn._kernels.compiled import in_place, kernel
from nsdyn._kernels.problem.blocks import unite
from nsdyn._kernels.reductions import most
from nsdyn._kernels.vectors import along, dot, row

ROUND_OFF = 1e-13
"""Gain that is nothing, as a fraction of the energies of which it is the difference: some hundred roundings."""

SMOOTH = 1e-3
"""Fraction of its kinetic energy up to which an island's loss in a step may be one of numerics: to what loses more, as
what comes to rest does, nothing is given back. Nor is more than that of what rolling resistance could take: a disc that
spins on its face has next to no rolling, and would be tipped."""


@in_place
def gains(mass, J, gravity, external, closed, states, owed, out):
    """What the energies of the free bodies grew by, beyond the works `external` (nf,), J.

    The states are (x, v) before and after. Into out (4, nf): the gain, kinetic energies before, and what of the gain is
    nothing, by round-off, and as contacts may be open or overlap by `closed` too. Returns whether a body gained more
    than nothing, or is `owed` (nf,) any.
    """
    x0, v0, x, v = states
    gain, kinetic, slack = out[0], out[1], out[2:]
    some = most(owed) > 0.0
    weight = math.sqrt(gravity[0] ** 2 + gravity[1] ** 2 + gravity[2] ** 2)
    for b in range(mass.size):
        i = 6 * b
        before, change, fall = 0.0, 0.0, 0.0
        for j in range(3):
            p, q = v0[i + j], v[i + j]
            before += 0.5 * mass[b] * p * p
            change += 0.5 * mass[b] * (q - p) * (q + p)
            fall += mass[b] * gravity[j] * (x[b, j] - x0[b, j])
            for k in range(3):
                before += 0.5 * v0[i + 3 + j] * J[b, j, k] * v0[i + 3 + k]
                change += 0.5 * (v[i + 3 + j] - v0[i + 3 + j]) * J[b, j, k] * (v[i + 3 + k] + v0[i + 3 + k])
        gain[b], kinetic[b] = change - fall - external[b], before
        slack[0, b] = ROUND_OFF * (before + abs(change) + abs(fall) + abs(external[b]))
        slack[1, b] = slack[0, b] + 2.0 * closed * mass[b] * weight
        some = some or gain[b] > slack[1, b]
    return some


@kernel
def opposing(root, whole, frame1, frame2, normal, angular, R, inverse_J):
    """Spins that a unit of rolling resistance gives the bodies, and what it takes from each island.

    Contact c turns its bodies by t and -t, t = -(1 - n nᵀ) (ω2 - ω1), or -(ω2 - ω1) on islands that are `whole`.

    Returns
    -------
    Σ‖t‖² (nf,) at the roots, Σ L·J⁻¹ L (nf,) at the roots with L the sum of the ±t on a body, J⁻¹ L (nf, 3).
    """
    free = root.size
    linear, square, moment, turn = np.zeros(free), np.zeros(free), np.zeros((free, 3)), np.zeros((free, 3))
    for c in range(frame1.size):
        a, b, n = frame1[c], frame2[c], row(normal, c)
        if (a < 0 and b < 0) or a >= free or b >= free:
            continue
        k = root[a if a >= 0 else b]
        t = (0.0, 0.0, 0.0)
        if a >= 0:
            t = along(t, 1.0, row(angular, a))
        if b >= 0:
            t = along(t, -1.0, row(angular, b))
        if not whole[k]:
            t = along(t, -dot(n, t), n)
        linear[k] += dot(t, t)
        for i in range(3):
            if a >= 0:
                moment[a, i] -= t[i]
            if b >= 0:
                moment[b, i] += t[i]
    for b in range(free):
        own = np.zeros(3)
        for i in range(3):
            own[i] = R[b, 0, i] * moment[b, 0] + R[b, 1, i] * moment[b, 1] + R[b, 2, i] * moment[b, 2]
        for i in range(3):
            for j in range(3):
                turn[b, i] += inverse_J[b, i, j] * own[j]
            square[root[b]] += own[i] * turn[b, i]
    return linear, square, turn


@kernel
def resist(found, owed, spare, frame1, frame2, normal, angular, R, inverse_J, v):
    """Change the spins in v so that no island of free bodies has gained energy.

    An island turns its bodies by α of `opposing`, which takes α Σ‖t‖² - ½ α² Σ L·J⁻¹ L: what it gained, or if that
    cannot be all it can. Where rolling resistance cannot take it and the spins about the normals can, as of a body that
    turns about its one normal, these are resisted as well. What was taken is `owed` (nf,), and given back where the
    island loses energy in smooth motion. Islands may gain what is to `spare`, and those of which frames beyond the free
    bodies are a part, what they do. `found` is what `gains` gives, and changed.
    """
    gain, kinetic, slack = found[0], found[1], found[2:]
    free = gain.size
    root, driven = np.arange(free), np.zeros(free, np.bool_)
    for c in range(frame1.size):
        if 0 <= frame1[c] < free and 0 <= frame2[c] < free:
            unite(root, frame1[c], frame2[c])
    for b in range(free):  # a root is the least of its island
        k = root[b] = root[root[b]]
        if k != b:
            gain[k] += gain[b]
            slack[0, k] += slack[0, b]
            slack[1, k] += slack[1, b]
            kinetic[k] += kinetic[b]
            owed[k] += owed[b]
            owed[b] = 0.0
    for c in range(frame1.size):
        a, b = frame1[c], frame2[c]
        if a >= free and 0 <= b < free:
            driven[root[b]] = True
        if b >= free and 0 <= a < free:
            driven[root[a]] = True
    excess, whole, some = np.zeros(free), np.zeros(free, np.bool_), False
    linear, square, turn = opposing(root, whole, frame1, frame2, normal, angular, R, inverse_J)
    for k in range(free):
        if root[k] != k or driven[k]:
            continue
        excess[k] = gain[k] - spare
        if excess[k] <= slack[0, k]:
            back = SMOOTH * 0.5 * linear[k] ** 2 / square[k] if square[k] > 0.0 else 0.0
            excess[k] = -min(owed[k], -gain[k], back) if -SMOOTH * kinetic[k] < gain[k] < 0.0 else 0.0
        whole[k] = excess[k] > 0.0 and linear[k] ** 2 <= 2.0 * square[k] * excess[k]
        some = some or whole[k]
    if some:
        most, cost, _ = opposing(root, whole, frame1, frame2, normal, angular, R, inverse_J)
        for k in range(free):
            whole[k] = whole[k] and most[k] ** 2 > 2.0 * cost[k] * excess[k]
        linear, square, turn = opposing(root, whole, frame1, frame2, normal, angular, R, inverse_J)
    alpha, total, more = np.zeros(free), 0.0, False
    for k in range(free):
        if root[k] != k or driven[k] or linear[k] == 0.0:
            more = more or excess[k] > slack[1, k]
            continue
        rest = linear[k] ** 2 - 2.0 * square[k] * excess[k]
        alpha[k] = 2.0 * excess[k] / (linear[k] + math.sqrt(rest)) if rest > 0.0 else linear[k] / square[k]
        lost = alpha[k] * (linear[k] - 0.5 * alpha[k] * square[k])
        owed[k] = max(0.0, owed[k] + lost)
        total -= lost
        more = more or excess[k] - lost > slack[1, k]
    for b in range(free):
        for i in range(3):
            v[6 * b + 3 + i] += alpha[root[b]] * turn[b, i]
    return total, more
