"""Contacts at which Coulomb's law may have other solutions, or none that is a force."""

import math

import numpy as np

from nsdyn._kernels.compiled import in_place, kernel


@in_place
def stopped(q, u, r, nc):
    """(most |q_N|, most |u_T - q_T|) of the first nc contacts that are pressed, m/s."""
    load = change = 0.0
    for c in range(nc):
        i = 3 * c
        if r[i] > 0.0:
            load = max(load, abs(q[i]))
            change = max(change, math.sqrt((u[i + 1] - q[i + 1]) ** 2 + (u[i + 2] - q[i + 2]) ** 2))
    return load, change


@in_place
def _add(blocks, c, i, y, W):
    """Row i of W_cc, from its diagonal on, into W (3, 3), with room y for what a row does to a block."""
    offset, block, start, H, m_start, _, minv = blocks
    for s in range(2):
        k = block[c, s]
        if k < 0:
            continue
        n, first = offset[k + 1] - offset[k], start[c, s]
        for q in range(n):
            y[q] = 0.0
        for p in range(n):
            x = H[first + i * n + p]
            if x != 0.0:
                base = m_start[k] + p * n
                for q in range(n):
                    y[q] += x * minv[base + q]
        for j in range(i, 3):
            for q in range(n):
                W[i, j] += y[q] * H[first + j * n + q]


DIRECTIONS = 180
"""Of slip, in which solutions of one contact are looked for; of two that are closer than 2° none is seen."""

ROUND_OFF = 1e-12
"""Of velocities of a contact, from which on they are of one sign."""


@kernel
def ambiguous(blocks, mu, u, r, out):
    """Contacts whose own law admits several solutions, the impulses of others given, into out; how many they are.

    Only where W_NN < μ‖W_NT‖: friction presses the contact on faster than the normal impulse opens it.
    """
    offset = blocks[0]
    W, q, some, widest = np.empty((3, 3)), np.empty(3), 0, 0
    for k in range(offset.size - 1):
        widest = max(widest, offset[k + 1] - offset[k])
    y = np.empty(widest)
    for c in range(mu.size):
        if mu[c] == 0.0:
            continue
        for i in range(3):
            for j in range(3):
                W[i, j] = 0.0
        _add(blocks, c, 0, y, W)
        if W[0, 0] >= mu[c] * math.sqrt(W[0, 1] ** 2 + W[0, 2] ** 2):
            continue
        _add(blocks, c, 1, y, W)
        _add(blocks, c, 2, y, W)
        W[1, 0], W[2, 0], W[2, 1] = W[0, 1], W[0, 2], W[1, 2]
        for i in range(3):
            q[i] = u[3 * c + i]
            for j in range(3):
                q[i] -= W[i, j] * r[3 * c + j]
        if _count(W, q, mu[c]) > 1:
            out[some] = c
            some += 1
    return some


@in_place
def _count(W, q, mu):
    """How many solutions u = W r + q, K* ∋ u + μ‖u_T‖ e_N ⟂ r ∈ K has of one contact: open, stick, and slip."""
    size = abs(q[0]) + abs(q[1]) + abs(q[2])
    found = 1 if q[0] >= -ROUND_OFF * size else 0
    x0, x1 = W[1, 1] * W[2, 2] - W[1, 2] ** 2, W[0, 2] * W[1, 2] - W[0, 1] * W[2, 2]
    x2 = W[0, 1] * W[1, 2] - W[0, 2] * W[1, 1]
    det = W[0, 0] * x0 + W[0, 1] * x1 + W[0, 2] * x2
    if abs(det) > ROUND_OFF * W[0, 0] * W[1, 1] * W[2, 2]:
        y1, y2 = W[0, 0] * W[2, 2] - W[0, 2] ** 2, W[0, 0] * W[1, 1] - W[0, 1] ** 2
        z = W[0, 1] * W[0, 2] - W[0, 0] * W[1, 2]
        normal = -(x0 * q[0] + x1 * q[1] + x2 * q[2]) / det
        first, second = -(x1 * q[0] + y1 * q[1] + z * q[2]) / det, -(x2 * q[0] + z * q[1] + y2 * q[2]) / det
        if normal > 0.0 and math.sqrt(first * first + second * second) <= (1.0 + ROUND_OFF) * mu * normal:
            found += 1
    last, known = 0.0, False
    t1, t2, cos, sin = 1.0, 0.0, math.cos(2.0 * math.pi / DIRECTIONS), math.sin(2.0 * math.pi / DIRECTIONS)
    for _ in range(DIRECTIONS + 1):
        # Slip along t takes the impulse r_N (1, -μ t), of which r_N leaves u_N = 0, and is across t nowhere else.
        t1, t2 = cos * t1 - sin * t2, sin * t1 + cos * t2
        stiff = W[0, 0] - mu * (W[0, 1] * t1 + W[0, 2] * t2)
        normal = -q[0] / stiff if stiff != 0.0 else -1.0
        if normal <= 0.0:
            known = False
            continue
        u1 = q[1] + normal * (W[0, 1] - mu * (W[1, 1] * t1 + W[1, 2] * t2))
        u2 = q[2] + normal * (W[0, 2] - mu * (W[1, 2] * t1 + W[2, 2] * t2))
        across = t1 * u2 - t2 * u1
        if known and (across > 0.0) != (last > 0.0) and t1 * u1 + t2 * u2 > 0.0:
            found += 1
        last, known = across, True
    return found
