"""A warm start: judged, improved by a few Newton steps island by island, and judged again, in one call."""

from nsdyn._kernels.compiled import kernel
from nsdyn._kernels.problem.blocks import judged
from nsdyn._kernels.solvers.newton import warm_islands


@kernel
def improve(
    blocks, q, mu, scales, r, u, label, islands, enough, accept, q_norm, largest, penalty, max_iter
):  # fmt: skip
    """`warm_islands` from r unless that is good `enough`, in place of r; u = W r + q where none is left, into u.

    The measures and shares of the islands into islands (2, nc). Returns their number, 0 if r was good enough, whether
    one is left, the factorisations, and the literature's error and the residual of r where none is left.
    """
    top, residual = judged(blocks, q, mu, scales, r, u)
    if top / q_norm <= enough and residual <= enough:
        return 0, False, 0, top / q_norm, residual
    measures, share, count = warm_islands(
        blocks, q, mu, scales, r, u, label, enough, accept, q_norm, largest, penalty, max_iter
    )  # fmt: skip
    left = False
    for k in range(measures.size):
        islands[0, k], islands[1, k] = measures[k], share[k]
        left = left or not measures[k] <= enough
    if not left:
        top, residual = judged(blocks, q, mu, scales, r, u)
    return measures.size, left, count, top / q_norm, residual
