"""Slip that ends or reverses within a move. Names are those of `nsdyn.stepping.contact_kinematics`."""

import math

from nsdyn._kernels.compiled import no_alloc
from nsdyn._kernels.stepping.law import SLIP, STICK, state
from nsdyn._kernels.vectors import square

ROUND = 0.5
"""Cosine of the angle from which on slip counts as reversed in a move: below 60° the mean slip gives its direction."""

STANDS = 1e-6
"""Slip at the end of a move that counts as none, as a fraction of the slip at its beginning."""


@no_alloc
def ending(r, y, b, mu, local, was, slid, out):
    """Contacts and joint rows whose slip at the beginning of a move ends or reverses before its end, into out (rows,).

    1: the row sticks at the end. 2: its slip has reversed, or it sticks by friction along its former slip. 0: neither.
    Returns the largest value of rows with an impulse. The solution is y = W r + b; was (nc,) are the states of the
    contacts in the last move, slid (joint rows,) the rows of dry joint friction that slid.
    """
    u_begin, u_free, jacobian_drift = local[0], local[2], local[3]
    nc, most = was.size, 0
    for c in range(mu.size):
        out[c] = 0
        if c < nc:
            sliding = was[c] == SLIP and mu[c] > 0.0
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
            continue  # it had stopped before the move
        # Of redundant contacts that share an impulse some may be at the friction limit though the body sticks.
        if found == STICK or after <= STANDS * STANDS * before:
            out[c] = 2 if gain > 0.0 else 1
        elif onward < ROUND * math.sqrt(before * after):
            out[c] = 2
        if found > 0:
            most = max(most, out[c])
    return most
