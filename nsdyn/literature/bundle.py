"""Bundle method on the norm of a nonsmooth equation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from nsdyn.literature._common import Method, Run
from nsdyn.literature.formulations import ELEMENTS, xuewen_soh_wanji
from nsdyn.problem.solution import Solution, Status
from nsdyn.tools.arrays import Array
from nsdyn.tools.options import Count, Options, Positive

Merit = Literal["alart-curnier", "fischer-burmeister", "jean-moreau", "natural", "xuewen-soh-wanji"]

MERITS = {**ELEMENTS, "xuewen-soh-wanji": xuewen_soh_wanji}
"""Equations F for which φ = ½‖F‖² can be minimised."""


def shortest(V: Array) -> Array:
    """Return the point of smallest norm of the convex hull of the rows of V, by non-negative least squares.

    The minimiser of ‖Vᵀλ‖² + (Σλ - 1)² over λ ≥ 0 is parallel to that over the simplex; division by Σλ scales it.
    """
    from scipy.optimize import nnls  # a tenth of a second that few callers need

    V = V / (np.linalg.norm(V, axis=1).min() or 1.0)
    weights = nnls(np.vstack((V.T, np.ones(V.shape[0]))), np.r_[np.zeros(V.shape[1]), 1.0])[0]
    return np.asarray(weights / weights.sum())


@dataclass(frozen=True)
class Bundle(Options, Method):
    """ε-subdifferential bundle method on φ = ½‖F(r)‖², the contact conditions as a minimisation.

    The direction is minus the shortest vector of the hull of the subgradients collected near r. If φ falls enough along
    it the step is serious: r moves and the bundle starts anew. Otherwise the step is null: the subgradient a little
    further along joins the bundle, and the oldest except the aggregate leave. If the hull nearly contains 0, r is
    stationary for this ε, which then shrinks.

    Strength: a reference for a handful of contacts, and the residual of last resort: every serious step lowers φ.
    Weakness: it is a first-order method, ten to a thousand times slower than Newton. Its theorem promises stationary
    points of φ, not solutions. On more than about 20 contacts expect a rough answer.

    Parameters
    ----------
    tol : float
        On `FC3D.error` [-] and `FC3D.residual` [m/s] alike.
    max_iter : int
        Largest number of steps, serious and null.
    function : {'fischer-burmeister', 'natural', 'alart-curnier', 'jean-moreau', 'xuewen-soh-wanji'}
        Equation F. φ of the first is smooth except for û; the last is the paper's, whose third equation flattens φ.
    size : int
        Number of subgradients kept.

    References
    ----------
    N. Pop, Bundle methods for a quasistatic contact problem with friction, section 4. C. Lemaréchal, 1975; P. Wolfe,
    1975.
    """

    tol: Positive = 1e-8
    max_iter: Count = 5000
    function: Merit = "fischer-burmeister"
    size: Count = 20

    def _solve(self, run: Run) -> Solution:
        scaled = run.scaled
        element, W, rho = MERITS[self.function], scaled.W, np.ones((run.problem.nc, 2))

        def value(x: Array) -> tuple[float, Array]:
            """Return φ and an element of its Clarke subdifferential, (∂F)ᵀ F."""
            F, F_u, F_r = element((W @ x + scaled.q).reshape(-1, 3), x.reshape(-1, 3), scaled.mu, rho)
            back_u, back_r = ((F[:, None, :] @ A)[:, 0].ravel() for A in (F_u, F_r))
            return 0.5 * float((F * F).sum()), np.asarray(W.T @ back_u + back_r)

        x = run.r * scaled.root
        phi, V = value(x)
        bundle, radius, count = [V], 0.1 * float(np.linalg.norm(scaled.q)), 0
        for count in range(1, self.max_iter + 1):
            hull = np.array(bundle)
            h = -shortest(hull) @ hull
            slope = float(h @ h)
            # The hull nearly contains 0 if its shortest vector is short compared with its subgradients.
            if slope <= 1e-12 * float((hull**2).sum(axis=1).max()) or slope == 0.0:
                radius *= 0.1
                bundle = [V]
                if radius < 1e-15 * float(np.linalg.norm(scaled.q)):
                    return run.finish(count, Status.STALLED)
                continue
            t = 2.0 * phi / slope  # Polyak's step to the known minimum 0, for φ quadratic along h
            while t * np.sqrt(slope) > 1e-2 * radius:
                trial, gradient = value(x + t * h)
                if trial <= phi - 0.1 * t * slope:
                    break
                t *= 0.5
            else:
                # Null step: add the subgradient at the end of the search, and -h in place of all earlier ones.
                bundle = [*bundle[-self.size + 2 :], -h, value(x + t * h)[1]]
                if len(bundle) >= self.size:
                    radius *= 0.5
                    bundle = [V, bundle[-1]]
                continue
            x, phi, V = x + t * h, trial, gradient
            bundle = [V]
            if run.done(x / scaled.root):
                break
        return run.finish(count)
