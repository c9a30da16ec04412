"""Worker of Pinocchio's own constraint solvers, run as a script on W, q and mu.

Pinocchio's blocks are ordered (T1, T2, N), and its operator must be symmetric. It gets the symmetric part of W, while
`FC3D.error` is measured with W itself. Only `solve` is timed.
"""

from __future__ import annotations

import resource
from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import scipy.sparse as sp
from serve import serve

DENSE = 60  # contacts up to which a dense operator is faster


def settings(solver: str, tol: float) -> Any:
    """Return settings: absolute tolerances; for ADMM the penalty rule of `solver`, and no full Lanczos per solve."""
    if solver == "PGS":
        out = pin.PGSSolverSettings()
        out.max_iterations = 10**8
    else:
        out = pin.ADMMSolverSettings()
        out.max_iterations = 10**6
        out.lanczos_size = 3
        out.admm_update_rule = getattr(pin.ADMMUpdateRule, solver.partition("-")[2])
    out.absolute_feasibility_tol = out.absolute_complementarity_tol = tol
    out.relative_feasibility_tol = out.relative_complementarity_tol = 0.0
    return out


def prepare(path: str, solver: str, tol: float) -> Callable[[], Callable[[], tuple[Any, int]]]:
    """Return a function that builds operator, constraints and solver anew for every call."""
    with np.load(path) as file:
        W = sp.csc_matrix(sp.bsr_matrix((file["data"], file["indices"], file["indptr"])))
        q, mu = file["q"], file["mu"]
    last = np.arange(q.size).reshape(-1, 3)[:, [1, 2, 0]].ravel()  # normal last
    first = np.argsort(last)
    W = (0.5 * (W + W.T))[last][:, last].tocsc()
    W.sort_indices()
    model = pin.Model()
    model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "body")
    dense = solver == "PGS" or mu.size <= DENSE

    def fresh() -> Callable[[], tuple[Any, int]]:
        operator = pin.DelassusOperatorDense(W.toarray()) if dense else pin.DelassusOperatorSparse(W)
        models, datas = pin.StdVec_ConstraintModel(), pin.StdVec_ConstraintData()
        for friction in mu:
            contact = pin.PointContactConstraintModel(model, 1, pin.SE3.Identity())
            contact.setFriction(float(friction))
            models.append(pin.ConstraintModel(contact))
            datas.append(pin.ConstraintData(contact.createData()))
        make, result = (
            (pin.PGSConstraintSolver, pin.PGSSolverResult())
            if solver == "PGS"
            else (pin.ADMMConstraintSolver, pin.ADMMSolverResult())
        )
        player, chosen, g = make(q.size), settings(solver, tol), q[last]

        def call() -> tuple[Any, int]:
            player.solve(operator, g, models, datas, chosen, result)
            return np.asarray(result.retrieveConstraintImpulses())[first], result.iterations

        return call

    return fresh


# PGS stores its matrix on the stack.
resource.setrlimit(resource.RLIMIT_STACK, (resource.getrlimit(resource.RLIMIT_STACK)[1],) * 2)
serve(prepare, warm=False)
