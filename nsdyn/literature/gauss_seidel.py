"""Block Gauss–Seidel with the local solvers, relaxations and orders of the literature."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal, get_args

import numpy as np

from nsdyn.literature._common import CHECK, Method, Run
from nsdyn.literature._frozen import defect
from nsdyn.literature._kernels import one_contact as _kernels
from nsdyn.problem.solution import Solution
from nsdyn.tools.options import Allowed, Count, Options, Positive

Local = Literal[
    "projection", "iterated-projection", "exact", "alart-curnier", "jean-moreau", "natural", "fischer-burmeister"
]
"""Local solvers, in the order of their numbers in `_kernels.one_contact`."""

Order = Literal["given", "shuffled", "reshuffled", "symmetric"]
Relaxation = Annotated[float, Allowed("between 0 and 2", lambda omega: 0.0 < omega < 2.0)]

LOCAL_ITERATIONS = 100
"""Largest number of iterations for one contact: Newton takes about 5, the fixed point on the cone some tens."""


@dataclass(frozen=True)
class GaussSeidel(Options, Method):
    """NSGS and PSOR: solve each contact in turn by a local solver, FC(W_cc/ω, q̄_c), without acceleration.

    Strength: granular scenes and loose tolerances, where no method is cheaper. Weakness: scenes in which information
    must travel far (stacks, walls, large mass ratios), with any options. For applications use `pgs`, which is fully
    compiled and accelerated; this class is for comparing the variants of the literature.

    Parameters
    ----------
    tol : float
        On `FC3D.error` [-] and `FC3D.residual` [m/s] alike.
    max_iter : int
        Sweeps.
    local : {'alart-curnier', 'jean-moreau', 'natural', 'fischer-burmeister', 'projection', 'iterated-projection', \
'exact'}
        Local solver: semismooth Newton on one of four maps; one step r ← P_K(r - ρ û), or repeated steps with
        Khobotov's ρ until they settle; or enumeration of take-off, stick and slip, each in closed form but for a root.
    local_tol : float, optional
        Tolerance of a local iteration, relative to ‖q‖; by default a tenth of the mean share of one contact in the last
        measured defect.
    omega : float
        Relaxation ω in (0, 2): below 1 is under-relaxed.
    order : {'given', 'shuffled', 'reshuffled', 'symmetric'}
        Order of the contacts: as in the problem, random, random in every sweep, or alternately forward and backward.

    References
    ----------
    F. Jourdan, P. Alart, M. Jean, CMAME 155, 1998. V. Acary, M. Brémond, O. Huber, On solving contact problems with
    Coulomb friction, 2018, section 4. O. Bonnefon, G. Daviet, Quartic formulation of Coulomb 3D frictional contact,
    2011.
    """

    tol: Positive = 1e-8
    max_iter: Count = 100_000
    local: Local = "alart-curnier"
    local_tol: Positive | None = None
    omega: Relaxation = 1.0
    order: Order = "given"

    def _solve(self, run: Run) -> Solution:
        problem, scaled, k = run.problem, run.scaled, 0
        kind = get_args(Local).index(self.local)
        size, share = float(np.linalg.norm(scaled.q)), 0.1 / np.sqrt(problem.nc)
        rng, order = np.random.default_rng(0), np.arange(problem.nc)
        if self.order == "shuffled":
            order = rng.permutation(order)
        x = run.r * scaled.root
        goal = 0.0
        for k in range(1, self.max_iter + 1):
            if self.order == "reshuffled":
                order = rng.permutation(order)
            elif self.order == "symmetric" and k > 1:
                order = np.ascontiguousarray(order[::-1])
            if k % CHECK == 1:
                goal = share * defect(scaled, x) if self.local_tol is None else self.local_tol * size
                goal = max(goal, 1e-16 * size)  # round-off of numbers of size q
            until = goal, LOCAL_ITERATIONS
            _kernels.sweep(scaled.csr, scaled.q, scaled.mu, order, kind, self.omega, until, x)
            if (k % CHECK == 0 or k == self.max_iter) and run.done(x / scaled.root):
                break
        return run.finish(k)
