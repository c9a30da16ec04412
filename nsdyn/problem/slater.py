"""Check that a solution is sure to exist: a Slater point, a velocity that opens every contact."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from nsdyn.problem import gauss
from nsdyn.problem.fc3d import FC3D

SIMPLEX = 2_000_000
"""Iterations of the simplex method times contacts, some seconds of work, after which `has_slater_point` gives up."""

CLEARANCE = 0.5
"""Fraction of the sought opening velocity that contacts may lack: inside K* is enough."""


def has_slater_point(problem: FC3D, facets: int = 16) -> bool | None:
    """Whether velocities exist that open every contact: Hᵀ v + q ∈ int K* for some v. Then a solution exists.

    First a velocity change is sought that opens the contacts by the largest velocity, as for a certificate. If none is
    found soon, a linear program is solved on a pyramid of `facets` facets inside K*. True is a proof. False may be
    wrong only when no velocity clears the cone by more than the gap between pyramid and cone (2 % of μ ‖u_T‖ for 16
    facets). None if the program took too many iterations (some seconds). Without factors the range of W replaces that
    of Hᵀ; with mass ratios from 1e10 on rounding hides parts of it, and False may be wrong. A body on one side of
    everything it touches can leave and has a Slater point; a box jammed between two walls has none.

    References
    ----------
    V. Acary, F. Cadoux, C. Lemaréchal, J. Malick, A formulation of the linear discrete Coulomb friction problem via
    convex optimization, ZAMM 91, 2011. A. Klarbring, J.-S. Pang, SIAM J. Optim. 8, 1998.
    """
    from scipy.optimize import linprog  # the import takes a tenth of a second and is rarely needed

    speed = float(np.abs(problem.q).max(initial=0.0)) or 1.0
    wanted = -problem.q
    wanted[0::3] += speed
    if problem.nc == 0 or gauss.least_direction(problem, wanted, CLEARANCE * speed).size:
        return True
    angle = 2.0 * np.pi * np.arange(facets) / facets
    nc, steep = problem.nc, problem.mu / np.cos(np.pi / facets)
    rows = np.empty((nc, facets, 3))  # u_N - steep d_k·u_T ≥ t for every facet
    rows[:, :, 0] = 1.0
    rows[:, :, 1:] = -steep[:, None, None] * np.column_stack((np.cos(angle), np.sin(angle)))
    G = sp.csr_array(
        sp.bsr_array((rows, np.arange(nc), np.arange(nc + 1)), shape=(facets * nc, 3 * nc), blocksize=(facets, 3))
    )
    # W scaled to a mean of one; the velocities of the bodies are fewer unknowns, if factors are known.
    B = problem.W / problem.scales.mean() if problem.blocks is None else problem.blocks.jacobian()
    A = sp.hstack((-(G @ B), sp.csr_array(np.ones((facets * nc, 1)))))
    cost = np.zeros(A.shape[1])
    cost[-1] = -1.0
    bounds = [(None, None)] * B.shape[1] + [(None, 1.0)]  # one unit of speed is clearance enough
    limit = {"maxiter": SIMPLEX // nc}
    out = linprog(cost, A_ub=A, b_ub=G @ problem.q / speed, bounds=bounds, method="highs-ds", options=limit)
    return bool(-out.fun > 1e-7) if out.status == 0 else None  # the feasibility tolerance of the library
