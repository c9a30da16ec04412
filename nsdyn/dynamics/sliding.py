"""Motion of an articulated tree on closed loops and driven joints, without forces, to second order."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from nsdyn._kernels import reductions as _reductions
from nsdyn._kernels.dynamics import trees as _trees
from nsdyn.dynamics.loops import Closures, admissible, factored
from nsdyn.dynamics.runge_kutta import fastest
from nsdyn.dynamics.values import Flow
from nsdyn.tools.arrays import Array
from nsdyn.tools.displacements import integrate

PASSES, HALVINGS = 8, 12
"""Most passes of Newton's method, and most halvings of a motion for which these passes are not enough. Three passes and
no halving are usual."""

SETTLED = 1e-12
"""Newton's method stops when the next pass would change the velocity by less than this fraction. The change is
extrapolated from the last two passes."""

RESOLVED = 0.1
"""Most that later passes may change the velocity which the first, linear pass predicts, as a fraction of it. At this
limit a vibration turns by a third of a rad, and the midpoint rule errs by a thousandth."""

APART = 1e-6
"""Speed at which loops open, as a fraction of the largest speed. Without driven joints that contradict the loops it is
round-off."""


def slide(model: pin.Model, data: pin.Data, closures: Closures, q: Array, v: Array, h: float) -> Flow:
    """Motion by the implicit midpoint rule, in pieces where a longer step cannot be solved or resolved.

    The work of the returned flow is that of the driven joints, which keep their speed. ArithmeticError if no piece is
    short enough; ValueError if driven joints keep loops from staying closed.

    Parameters
    ----------
    model, data : pinocchio.Model, pinocchio.Data
        Without gravity.
    closures : Closures
        With the driven joints.
    q, v : ndarray, shapes (nq,), (nv,)
    h : float
        s.
    """
    left, piece, mean, work = h, h, np.zeros_like(v), 0.0
    while True:
        try:
            new = _midpoint(model, data, closures, q, v, piece)
        except (ValueError, ArithmeticError) as failure:
            if piece <= h * 0.5**HALVINGS:
                opening = _reductions.largest(closures.at(q)[1] @ v)
                if closures.driven.size and opening > APART * _reductions.largest(v):
                    raise ValueError(
                        f"prescribed motions contradict: in {model.name!r} they open loops or gears by {opening:.3g} "
                        f"rad/s or m/s: {failure}"
                    ) from failure
                raise ArithmeticError(
                    f"in {model.name!r} {fastest(model, v)}, too wildly to follow its loops in {piece:.3g} s: {failure}"
                ) from failure
            piece *= 0.5
            continue
        if piece == h:
            return new
        q, v, left = new.q, new.v, left - piece
        mean += piece / h * new.mean
        work += new.work
        if left <= 0.0:
            return Flow(q, v, mean, work)
        piece = min(2.0 * piece, left)


def _midpoint(model: pin.Model, data: pin.Data, closures: Closures, q: Array, v: Array, h: float) -> Flow:
    """One step of the implicit midpoint rule, by Newton's method with the matrix of the beginning.

    The velocity at the end is admissible for the loops at the end. Raises ValueError or ArithmeticError if no such
    motion is found.
    """
    n, size = v.size, closures.size
    middle = closures.close(integrate(model, q, 0.5 * h * v))
    M, F, _ = factored(model, data, middle)
    B = np.concatenate((closures.at(middle)[1], closures.driven))
    Z, P = admissible(B, F, closures.of_loops)
    minv, b = Z @ Z.T, B @ v
    b[:size] = 0.0
    rest = start = minv @ (M @ v)
    pin.computeRNEADerivatives(model, data, middle, v, np.zeros(n))
    newton = np.linalg.inv(np.eye(n) + 0.5 * h * (minv @ data.dtau_dv.reshape(n, n)))
    new, left, change = v.copy(), np.empty(n), SETTLED
    for k in range(PASSES):
        mean = 0.5 * (v + new)
        bias = pin.nonLinearEffects(model, data, middle, mean)
        if k < 2:
            # Update the end in the first two passes only. Later updates would diverge if the step is longer than the
            # way to a singular configuration.
            end = integrate(model, q, h * mean)
            b[:size] = (B[:size] - closures.at(end)[1]) @ new
            start = rest + P @ b
        last, change = change, _trees.settle(start, minv, bias, h, newton, left, new)
        if k == 0:
            foreseen = new.copy()
        if k and change * min(change, last) <= SETTLED * last:
            break
    else:
        raise ArithmeticError("Newton's method does not settle")
    if not _reductions.largest(new - foreseen) <= RESOLVED * _reductions.largest(new):
        raise ArithmeticError("the motion is not resolved")
    mean = 0.5 * (v + new)
    reaction = P.T @ (M @ (new - v) + h * bias)
    work = float((B[size:] @ mean) @ reaction[size:])
    return Flow(closures.close(integrate(model, q, h * mean)), new, mean, work)
