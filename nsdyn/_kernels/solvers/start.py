"""What a solve begins with, in one call: judge the start, solve whole what is small, judge again."""

import numpy as np

from nsdyn._kernels.compiled import kernel
from nsdyn._kernels.problem.blocks import judged
from nsdyn._kernels.problem.cones import measures as of_impulse
from nsdyn._kernels.solvers import pgs
from nsdyn._kernels.solvers.local import islands as islands_of_matrix
from nsdyn._kernels.solvers.local import solve_small
from nsdyn._kernels.solvers.newton import measures_of_islands, small_islands


@kernel
def by_factors(
    blocks, q, mu, scales, r, u, label, islands, enough, accept, q_norm, largest, penalty, max_iter
):  # fmt: skip
    """`small_islands` from r unless that is good `enough`, in place of r; u = W r + q where none is left, into u.

    The measures and shares of the islands into islands (2, nc). Returns their number, 0 if r was good enough, whether
    one is left, the factorisations, and the literature's error and the residual of r where none is left.
    """
    top, residual = judged(blocks, q, mu, scales, r, u)
    if top / q_norm <= enough and residual <= enough:
        return 0, False, 0, top / q_norm, residual
    measures, share, count = small_islands(
        blocks, q, mu, scales, r, u, label, enough, accept, q_norm, largest, penalty, max_iter
    )  # fmt: skip
    left = False
    for k in range(measures.size):
        islands[0, k], islands[1, k] = measures[k], share[k]
        left = left or not measures[k] <= enough
    if not left:
        top, residual = judged(blocks, q, mu, scales, r, u)
    return measures.size, left, count, top / q_norm, residual


@kernel
def by_matrix(
    W, q, mu, scales, r, u, label, islands, tol, margin, q_norm, largest, quick, penalty, warm, most, sweeps, patience
):  # fmt: skip
    """The same by `local.solve_small` for a block-sparse W = (indptr, indices, data), unless r meets `tol`.

    Islands share `margin` of the tolerance by contacts, those of at most `largest` contacts as their mean.
    """
    indptr, indices, data = W
    pgs.velocity(indptr, indices, data, q, r, u)
    top, residual = of_impulse(scales, u, r, mu)
    if top / q_norm <= tol and residual <= tol:
        return 0, False, 0, top / q_norm, residual
    found = islands_of_matrix(indptr, indices, label)
    share = np.zeros(found)
    for c in range(label.size):
        share[label[c]] += 1.0 / label.size
    small = share <= largest / label.size
    mean = share[small].mean() if small.any() else 0.0
    share = margin * np.sqrt(np.where(small, mean, share))
    count = solve_small(
        indptr, indices, data, q, mu, scales, r, tol * margin * np.sqrt(mean), q_norm, label, found, largest, quick,
        penalty, warm, most, sweeps, patience,
    )  # fmt: skip
    pgs.velocity(indptr, indices, data, q, r, u)
    top, residual = of_impulse(scales, u, r, mu)
    islands[0, :found] = measures_of_islands(label, found, scales, q_norm, u, r, mu)
    islands[1, :found] = share
    left = (islands[0, :found] > tol * share).any()
    return found, left, count, top / q_norm, residual
