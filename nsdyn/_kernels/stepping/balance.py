"""What free bodies gained in a step, and the rolling resistance that takes it from their islands."""

import math

import numpy as np

from nsdyn._kernels.compiled import kernel
from nsdyn._kernels.problem.blocks import unite
from nsdyn._kernels.vectors import along, dot, row

ROUND_OFF = 1e-13
"""Gain that is nothing, as a fraction of the energies of which it is the difference: some hundred roundings."""

SMOOTH = 1e-3
"""Fraction of its kinetic energy up to which an island's loss in a step may be one of numerics: to what loses more, as
what comes to rest does, nothing is given back."""


@kernel
def gains(mass, J, gravity, external, closed, x0, v0, x, v, gain, slack, kinetic):
    """What the energies of the free bodies grew by, beyond the works `external` (nf,), into gain (nf,), J.

    What of it is nothing, by round-off and as contacts may be open or overlap by `closed`, into slack (nf,); kinetic
    energies before into kinetic (nf,). Returns whether a body gained more than nothing.
    """
    some = False
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
        slack[b] = ROUND_OFF * (before + abs(change) + abs(fall) + abs(external[b])) + 2.0 * closed * mass[b] * weight
        some = some or gain[b] > slack[b]
    return some


@kernel
def resist(gain, slack, kinetic, owed, spare, frame1, frame2, normal, angular, R, inverse_J, v):
    """Change the spins in v so that no island of free bodies has gained energy; returns what they gained by that, J.

    Contact c turns its bodies by α t and -α t, t = -(1 - n nᵀ) (ω2 - ω1), with one α for its island: what it gained is
    α Σ‖t‖² - ½ α² Σ L·J⁻¹ L, L the sum of the ±t on a body, or if that cannot be all it can. What was taken is `owed`
    (nf,), and given back where the island loses energy in smooth motion. Islands may gain what is to `spare`, and those
    of which frames beyond the free bodies are a part, what they do.
    """
    free = gain.size
    root, driven = np.arange(free), np.zeros(free, np.bool_)
    for c in range(frame1.size):
        if 0 <= frame1[c] < free and 0 <= frame2[c] < free:
            unite(root, frame1[c], frame2[c])
    for b in range(free):  # a root is the least of its island
        k = root[b] = root[root[b]]
        if k != b:
            gain[k] += gain[b]
            slack[k] += slack[b]
            kinetic[k] += kinetic[b]
            owed[k] += owed[b]
            owed[b] = 0.0
    for c in range(frame1.size):
        a, b = frame1[c], frame2[c]
        if a >= free and 0 <= b < free:
            driven[root[b]] = True
        if b >= free and 0 <= a < free:
            driven[root[a]] = True
    linear, square, moment = np.zeros(free), np.zeros(free), np.zeros((free, 3))
    for c in range(frame1.size):
        a, b, n = frame1[c], frame2[c], row(normal, c)
        if (a < 0 and b < 0) or a >= free or b >= free:
            continue
        t = (0.0, 0.0, 0.0)
        if a >= 0:
            t = along(t, 1.0, row(angular, a))
        if b >= 0:
            t = along(t, -1.0, row(angular, b))
        t = along(t, -dot(n, t), n)
        linear[root[a if a >= 0 else b]] += dot(t, t)
        for i in range(3):
            if a >= 0:
                moment[a, i] -= t[i]
            if b >= 0:
                moment[b, i] += t[i]
    turn = np.zeros((free, 3))
    for b in range(free):
        own = np.zeros(3)
        for i in range(3):
            own[i] = R[b, 0, i] * moment[b, 0] + R[b, 1, i] * moment[b, 1] + R[b, 2, i] * moment[b, 2]
        for i in range(3):
            for j in range(3):
                turn[b, i] += inverse_J[b, i, j] * own[j]
            square[root[b]] += own[i] * turn[b, i]
    alpha, total = np.zeros(free), 0.0
    for k in range(free):
        if root[k] != k or driven[k] or linear[k] == 0.0:
            continue
        excess = gain[k] - spare
        if excess <= slack[k]:
            excess = -min(owed[k], -gain[k]) if -SMOOTH * kinetic[k] < gain[k] < 0.0 else 0.0
        rest = linear[k] ** 2 - 2.0 * square[k] * excess
        alpha[k] = 2.0 * excess / (linear[k] + math.sqrt(rest)) if rest > 0.0 else linear[k] / square[k]
        lost = alpha[k] * (linear[k] - 0.5 * alpha[k] * square[k])
        owed[k] = max(0.0, owed[k] + lost)
        total -= lost
    for b in range(free):
        for i in range(3):
            v[6 * b + 3 + i] += alpha[root[b]] * turn[b, i]
    return total
