"""Worker of Siconos's solvers, for the system's Python and Debian's python3-siconos; imports nothing of nsdyn.

A solver is named ``NAME``, with W in 3 x 3 blocks, Siconos's fast storage, or ``NAME/dense``, with dense W, which is
faster on small problems. Only the driver is timed. ``--list`` prints the names.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import scipy.sparse as sp
import siconos.numerics as sn
from serve import serve

MANY = 10**8  # iterations: the time limit ends solves that do not converge

# Solver, iteration limit, integer options by index, local solver with its tolerance and iterations.
SOLVERS: dict[str, tuple[str, int, Mapping[int, int], tuple[Any, ...]]] = {
    "PROX": ("PROX", 10_000, {}, ()),
    "NSN_AC": ("NSN_AC", 2000, {}, ()),
    "NSN_AC-JM": ("NSN_AC", 2000, {10: 1}, ()),  # Jean-Moreau
    "NSN_AC-NLS": ("NSN_AC", 2000, {11: -1}, ()),  # no line search
    "NSN_AC-CSLU": ("NSN_AC", 2000, {13: 0}, ()),  # CSparse's LU
    "NSN_AC-HYB": ("NSN_AC", 2000, {14: 3}, ()),  # extragradient first
    "NSN_AC_TEST": ("NSN_AC_TEST", 2000, {}, ()),
    "NSN_FB": ("NSN_FB", 2000, {}, ()),
    "NSN_NM": ("NSN_NM", 2000, {}, ()),
    "NSGS": ("NSGS", MANY, {}, ()),
    "NSGS-NSN": ("NSGS", MANY, {}, ("ONECONTACT_NSN",)),
    "NSGS-PLI": ("NSGS", MANY, {}, ("ONECONTACT_ProjectionOnConeWithLocalIteration", 1e-14, 100)),
    "NSGS-PoC": ("NSGS", MANY, {}, ("ONECONTACT_ProjectionOnCone",)),
    "NSGS-QUARTIC": ("NSGS", MANY, {}, ("ONECONTACT_QUARTIC",)),
    "NSGS-QUARTIC_NU": ("NSGS", MANY, {}, ("ONECONTACT_QUARTIC_NU",)),
    "ADMM": ("ADMM", 10**7, {}, ()),
    "ADMM-BAL": ("ADMM", 10**7, {9: 2}, ()),  # residual balancing
    "ADMM-SBAL": ("ADMM", 10**7, {9: 3}, ()),  # scaled residual balancing
    "EG": ("EG", MANY, {}, ()),
    "FPP": ("FPP", MANY, {}, ()),
    "DSFP": ("DSFP", MANY, {}, ()),
    "TFP": ("TFP", 10**6, {}, ()),
    "ACLMFP": ("ACLMFP", 10**6, {}, ()),
}


def options(name: str, tol: float) -> Any:
    """Return new options, because a solve modifies them."""
    solver, iterations, integers, local = SOLVERS[name]
    out = sn.SolverOptions(getattr(sn, f"SICONOS_FRICTION_3D_{solver}"))
    out.dparam[0], out.iparam[0] = tol, iterations
    for index, value in integers.items():
        out.iparam[index] = value
    if local:
        sn.solver_options_update_internal(out, 0, getattr(sn, f"SICONOS_FRICTION_3D_{local[0]}"))
        if len(local) > 1:
            inner = sn.solver_options_get_internal_solver(out, 0)
            inner.dparam[0], inner.iparam[0] = local[1:]
    return out


def prepare(path: str, solver: str, tol: float) -> Callable[[], Callable[[], tuple[Any, int]]]:
    """Return a function that builds problem and options anew for every call, because a solve modifies both."""
    name, _, storage = solver.partition("/")
    with np.load(path) as file:
        W = sp.csc_matrix(sp.bsr_matrix((file["data"], file["indices"], file["indptr"])))
        q, mu = file["q"], file["mu"]
    W.indices, W.indptr = W.indices.astype(np.int64), W.indptr.astype(np.int64)
    kept: list[Any] = []  # Siconos does not own the arrays

    def fresh() -> Callable[[], tuple[Any, int]]:
        stored = np.asfortranarray(W.toarray()) if storage else sn.SBM_from_csparse(3, W)[1]
        problem, chosen = sn.FrictionContactProblem(3, mu.size, stored, q, mu), options(name, tol)
        r, u = np.zeros(q.size), np.zeros(q.size)
        kept[:] = [stored]

        def call() -> tuple[Any, int]:
            sn.fc3d_driver(problem, r, u, chosen)
            return r, chosen.iparam[1]

        return call

    return fresh


if "--list" in sys.argv:
    print(json.dumps(list(SOLVERS)))
else:
    serve(prepare, warm=False)
