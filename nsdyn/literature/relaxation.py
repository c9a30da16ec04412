"""Convex relaxation of the frictional contact problem, as a start for other solvers."""

from __future__ import annotations

import numpy as np

from nsdyn.literature._common import Equilibrated
from nsdyn.literature._frozen import descend
from nsdyn.literature._kernels import variational as _kernels
from nsdyn.problem.fc3d import FC3D
from nsdyn.tools.arrays import Array


def relaxed(problem: FC3D, tol: float = 1e-4, max_sweeps: int = 2000, r0: Array | None = None) -> Array:
    """Minimise ½ rᵀWr + qᵀr on K, the problem without de Saxcé's shift; return r, shape (3 nc,), N·s.

    W r + q ∈ K* and r ∈ K are orthogonal. So a sliding contact opens at u_N = μ‖u_T‖ (dilation), which is no motion
    under Coulomb's law. If no contact slides the minimiser solves Coulomb's problem; otherwise it is a start for other
    solvers. The method is accelerated Gauss–Seidel sweeps, which are slow on redundant contacts.

    Parameters
    ----------
    problem : FC3D
    tol : float
        On the last change of the equilibrated impulses relative to the free velocities.
    max_sweeps : int
        Largest number of sweeps; the last iterate is then returned unchanged.
    r0 : ndarray, shape (3 nc,), optional
        Initial impulse, default 0.

    References
    ----------
    V. Acary, M. Brémond, O. Huber, On solving contact problems with Coulomb friction, 2018, section 4. A. Tasora,
    M. Anitescu, A matrix-free cone complementarity approach, CMAME 200, 2011.
    """
    scaled = Equilibrated(problem)
    x = np.zeros_like(problem.q) if r0 is None else problem.impulse(r0) * scaled.root
    goal = tol * float(np.linalg.norm(scaled.q))
    x, _ = descend(lambda y: _kernels.cone_sweep(*scaled.csr, scaled.q, scaled.mu, y), x, goal, max_sweeps)
    return np.asarray(x / scaled.root)
