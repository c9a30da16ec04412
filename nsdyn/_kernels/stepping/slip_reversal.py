"""Slip that ends, or turns round, within a move. Names are those of `nsdyn.stepping.contact_kinematics`."""

import math

from nsdyn._kernels.compiled import no_alloc
from nsdyn._kernels.stepping.law import state
from nsdyn._kernels.vectors import square

ROUND = 0.5
"""Cosine of the angle from which on slip has turned round in a move: by less than 60° its mean tells its direction."""

STANDS = 1e-6
"""Fraction of the slip where a move begins that is none at its end."""


@no_alloc
def ending(r, y, b, mu, local, was, slid, out):
    """Contacts and joint rows that slide where a move begins, and no longer that way at its end, into out (rows,).

    1 where it sticks, 2 where it has turned round, or sticks by friction along the slip it had, 0 else; returns the
    most of those that are pressed. The solution is y = W r + b, was (nc,) what the contacts were in the last move, slid
    (joint rows,) which of those are dry friction that slid.
    """
    u_begin, u_free, jacobian_drift = local[0], local[2], local[3]
    nc, most = was.size, 0
    for c in range(mu.size):
        out[c] = 0
        if c < nc:
            sliding = was[c] == 2 and mu[c] > 0.0
        else:
            sliding = slid[c - nc]
        if not sliding:
            continue
        found = state(r, mu[c], 3 * c)
        onward, before, after, gain = 0.0, 0.0, 0.0, 0.0
        for j in range(3 * c + 1, 3 * c + 3):
            end = y[j] - b[j] + u_free[j] + jacobian_drift[j]
            onward, before, after = onward + u_begin[j] * end, before + square(u_begin[j]), after + square(end)
            gain += r[j] * (u_begin[j] + end)
        if before == 0.0:
            continue  # it has stopped where the move begins
        # Of what redundant contacts share some may be at its limit though the body sticks.
        if found == 1 or after <= STANDS * STANDS * before:
            out[c] = 2 if gain > 0.0 else 1
        elif onward < ROUND * math.sqrt(before * after):
            out[c] = 2
        if found > 0:
            most = max(most, out[c])
    return most
