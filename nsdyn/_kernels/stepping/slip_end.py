"""Slip that stops or reverses within a move. Names are those of `nsdyn.stepping.contact_kinematics`."""

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
    """Contacts and joint rows whose slip at the beginning of a move stops or reverses before its end, into out (rows,).

    A slip that is no more than the drift, with the drift or without, has stopped: a body that stops does not turn as
    the drift foresees. Returns whether any row with an impulse is marked. The solution is y = W r + b; was (nc,) are
    the states of the contacts in the last move, slid (joint rows,) the rows of dry joint friction that slid.
    """
    u_begin, u_free, jacobian_drift = local[0], local[2], local[3]
    nc, some = was.size, False
    for c in range(mu.size):
        out[c] = False
        if c < nc:
            sliding = was[c] == SLIP and mu[c] > 0.0
        else:
            sliding = slid[c - nc]
        if not sliding:
            continue
        onward, before, after, drift, unturned = 0.0, 0.0, 0.0, 0.0, 0.0
        for j in range(3 * c + 1, 3 * c + 3):
            end = y[j] - b[j] + u_free[j] + jacobian_drift[j]
            onward, before, after = onward + u_begin[j] * end, before + square(u_begin[j]), after + square(end)
            drift, unturned = drift + square(jacobian_drift[j]), unturned + square(end - jacobian_drift[j])
        if before == 0.0:
            continue  # it had stopped before the move
        found = state(r, mu[c], 3 * c)
        # Of redundant contacts that share an impulse some may be at the friction limit though the body sticks.
        stops = found == STICK or min(after, unturned) <= max(STANDS * STANDS * before, drift)
        out[c] = stops or onward < ROUND * math.sqrt(before * after)
        some = some or (out[c] and found > 0)
    return some
