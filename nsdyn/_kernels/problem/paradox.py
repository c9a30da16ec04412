"""Contacts at which Coulomb's law may have other solutions, or none that a force can give."""

import math

import numpy as np

from nsdyn._kernels.compiled import kernel, no_alloc
from nsdyn._kernels.problem.blocks import diagonal_block, widest
from nsdyn._kernels.vectors import adjugate, row, square, three


@no_alloc
def stopped(q, u, r, nc):
    """Return (largest |q_N|, largest |u_T - q_T|) of the pressed contacts among the first nc, m/s."""
    load = change = 0.0
    for c in range(nc):
        i = 3 * c
        if r[i] > 0.0:
            load = max(load, abs(q[i]))
            change = max(change, math.sqrt(square(u[i + 1] - q[i + 1]) + square(u[i + 2] - q[i + 2])))
    return load, change


ODD = 10.0
"""Ratio of the change of slip to the loads on the normals above which a jam is possible. Where friction is a force the
ratio is at most of the order of μ."""

DIRECTIONS = 180
"""Number of slip directions at which solutions of one contact are bracketed. Two solutions closer than 2° are not
seen."""

COS, SIN = (of(2.0 * np.pi / DIRECTIONS * np.arange(DIRECTIONS + 1)) for of in (np.cos, np.sin))

SECANTS, MOST = 12, 6
"""Secant steps to such a direction, down to round-off, and most solutions: open, stick, and four directions of slip."""

ROUND_OFF = 1e-12
"""Relative round-off of the velocities of a contact, above which their sign is certain."""


@kernel
def ambiguous(blocks, mu, u, r, out):
    """Write the contacts whose own law admits several solutions into out; return how many they are.

    The impulses of the other contacts are given. Several solutions need W_NN < μ‖W_NT‖: friction presses the contact on
    faster than the normal impulse opens it. A contact is excluded if it sticks under a load, q_N < 0, with little
    friction, μ |q_N| ≥ ‖r_T‖ (W_NN + μ‖W_NT‖). It cannot open. If it slipped with r', then (r' - r)ᵀ W (r' - r) > 0
    would require μ r'_N < ‖r_T‖, but r'_N ≥ |q_N| / (W_NN + μ‖W_NT‖).
    """
    most, some = widest(blocks[0]), 0
    x, y, W = np.empty((3, most)), np.empty((3, most)), np.empty((3, 3))
    q, all_of_one = np.empty(3), np.empty((MOST, 3))
    for c in range(mu.size):
        if mu[c] == 0.0:
            continue
        diagonal_block(blocks, c, 1, x, y, W)
        pressed, across = W[0, 0], mu[c] * math.sqrt(square(W[0, 1]) + square(W[0, 2]))
        if pressed >= across:
            continue
        i = 3 * c
        load = W[0, 0] * r[i] + W[0, 1] * r[i + 1] + W[0, 2] * r[i + 2] - u[i]
        friction = math.sqrt(square(r[i + 1]) + square(r[i + 2]))
        if friction < mu[c] * r[i] and mu[c] * load >= friction * (pressed + across):
            continue
        diagonal_block(blocks, c, 3, x, y, W)
        for i in range(3):
            q[i] = u[3 * c + i]
            for j in range(3):
                q[i] -= W[i, j] * r[3 * c + j]
        if solutions(W, q, mu[c], all_of_one) > 1:
            out[some] = c
            some += 1
    return some


@no_alloc
def _slipping(w, q, mu, t1, t2):
    """Return (s, s u_T) of slip along t under an impulse r_N (1, -μ t) that leaves u_N = s r_N + q_N = 0.

    w is the upper triangle of the symmetric W, row by row.
    """
    s = w[0] - mu * (w[1] * t1 + w[2] * t2)
    u1 = s * q[1] - q[0] * (w[1] - mu * (w[3] * t1 + w[4] * t2))
    u2 = s * q[2] - q[0] * (w[2] - mu * (w[4] * t1 + w[5] * t2))
    return s, u1, u2


@no_alloc
def _across(w, q, mu, t1, t2):
    """Return the component of s u_T of `_slipping` across t."""
    _, u1, u2 = _slipping(w, q, mu, t1, t2)
    return t1 * u2 - t2 * u1


@kernel
def solutions(W, q, mu, out):
    """Write all solutions r of one contact into out (6, 3); return how many.

    They solve u = W r + q, K* ∋ u + μ‖u_T‖ e_N ⟂ r ∈ K. The contact can open where q_N ≥ 0, and stick where -W⁻¹ q is
    in K. It can slip along t where the u_T of `_slipping` is along t. There are at most four such t, the roots of a
    quartic, which are bracketed by directions and found by secants (Illinois).
    """
    size, found = abs(q[0]) + abs(q[1]) + abs(q[2]), 0
    if q[0] >= -ROUND_OFF * size:
        out[0, 0] = out[0, 1] = out[0, 2] = 0.0
        found = 1
    (x, y, z), det = adjugate(W)
    if abs(det) > ROUND_OFF * W[0, 0] * W[1, 1] * W[2, 2]:
        for i in range(3):
            out[found, i] = -(x[i] * q[0] + y[i] * q[1] + z[i] * q[2]) / det
        normal, first, second = row(out, found)
        if normal > 0.0 and math.sqrt(first * first + second * second) <= (1.0 + ROUND_OFF) * mu * normal:
            found += 1
    # Scalars only, so that the compiler uses vector instructions in the loop.
    turned, w, q = np.empty(DIRECTIONS + 1), (*row(W, 0), W[1, 1], W[1, 2], W[2, 2]), three(q, 0)
    for k in range(DIRECTIONS + 1):
        turned[k] = _across(w, q, mu, COS[k], SIN[k])
    for k in range(DIRECTIONS):
        before, after = turned[k], turned[k + 1]
        if (after > 0.0) == (before > 0.0):
            continue
        a1, a2, b1, b2 = COS[k], SIN[k], COS[k + 1], SIN[k + 1]
        might, may = _slipping(w, q, mu, a1, a2)[0], _slipping(w, q, mu, b1, b2)[0]
        if might * q[0] >= 0.0 and may * q[0] >= 0.0:
            continue
        c1, c2, f, g, side = b1, b2, abs(before), abs(after), 0
        for _ in range(SECANTS):
            t1, t2 = g * a1 + f * c1, g * a2 + f * c2
            size = math.sqrt(t1 * t1 + t2 * t2)
            t1, t2 = t1 / size, t2 / size
            across = _across(w, q, mu, t1, t2)
            if abs(across) <= 1e-16 * (abs(before) + abs(after)):
                break
            # The value at an end that stays is halved.
            if (across > 0.0) == (before > 0.0):
                a1, a2, f, g, side = t1, t2, abs(across), 0.5 * g if side < 0 else g, -1
            else:
                c1, c2, g, f, side = t1, t2, abs(across), 0.5 * f if side > 0 else f, 1
        s, u1, u2 = _slipping(w, q, mu, t1, t2)
        if s * q[0] < 0.0 and s * (t1 * u1 + t2 * u2) > 0.0 and found < MOST:
            normal = -q[0] / s
            out[found, 0], out[found, 1], out[found, 2] = normal, -mu * normal * t1, -mu * normal * t2
            found += 1
    return found


@kernel
def suspect(blocks, mu, q, u, r, few):
    """Whether a solution may jam, or, for at most `few` contacts, may be one of several."""
    load, change = stopped(q, u, r, mu.size)
    if change > ODD * load:
        return True
    return mu.size <= few and ambiguous(blocks, mu, u, r, np.empty(mu.size, np.int64)) > 0
