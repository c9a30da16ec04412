"""Formulations of the frictional contact problem as nonsmooth equations: every function is zero at a solution.

With u = W r + q and û = u + μ‖u_T‖ e_N, each ``residual_*`` maps an impulse r [N·s] to F(r). Steps ρ [kg] turn a
velocity into an impulse. A step is a number, one per contact, or a pair (normal, tangential) per contact if the map
allows it; the default 1/λ_max(W_cc) does not depend on units. The four maps of `ELEMENTS` also return an element of
their generalised Jacobian.

References
----------
V. Acary, M. Brémond, O. Huber, On solving contact problems with Coulomb friction, 2018, sections 3 and 4; the
derivatives are those of its appendix with the misprints corrected (finite differences are the test).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import scipy.sparse as sp

from nsdyn.literature._kernels import one_contact as _kernels
from nsdyn.problem import cones
from nsdyn.problem.fc3d import FC3D
from nsdyn.tools.arrays import Array
from nsdyn.tools.naming import choice

Element = tuple[Array, Array, Array]
"""(F, ∂F/∂u, ∂F/∂r) per contact: shapes (nc, 3), (nc, 3, 3), (nc, 3, 3)."""


def _steps(problem: FC3D, rho: Any) -> Array:
    """Return steps as an array (nc, 2), normal and tangential; ValueError unless they are positive."""
    given = 1.0 / problem.scales if rho is None else np.asarray(rho, dtype=float)
    out = np.broadcast_to(given[:, None] if given.ndim == 1 else given, (problem.nc, 2))
    if not (out > 0.0).all():
        raise ValueError("rho must be positive")
    return out


def _uniform(problem: FC3D, rho: Any) -> Array:
    """Return steps as an array (nc,); ValueError for pairs, which the cone does not allow."""
    out = _steps(problem, rho)
    if (out[:, 0] != out[:, 1]).any():
        raise ValueError("rho must be one number per contact: the projection on the cone is not split")
    return out[:, 0]


def _state(problem: FC3D, r: Array) -> tuple[Array, Array]:
    """Return (u, r) as arrays (nc, 3)."""
    r = np.asarray(r, dtype=float)
    return problem.velocity(r.ravel()).reshape(-1, 3), r.reshape(-1, 3)


def _direction(x: Array) -> tuple[Array, Array]:
    """Return (‖x‖, x/‖x‖ or 0) of vectors (nc, 2)."""
    size = np.hypot(x[:, 0], x[:, 1])
    return size, np.divide(x, size[:, None], out=np.zeros_like(x), where=size[:, None] > 0.0)


def _element(kind: int, u: Array, r: Array, mu: Array, rho: Array) -> Element:
    """Map of that kind at u and r (nc, 3), with steps (nc, 1 or 2)."""
    steps = np.array(np.broadcast_to(rho, (mu.size, 2)))
    F, F_u, F_r = np.empty((mu.size, 3)), np.empty((mu.size, 3, 3)), np.empty((mu.size, 3, 3))
    _kernels.elements(kind, np.array(u), np.array(r), mu, steps, F, F_u, F_r)
    return F, F_u, F_r


def xuewen_soh_wanji(u: Array, r: Array, mu: Array, rho: Array) -> Element:
    """Three equations of `residual_xuewen_soh_wanji`; not in `ELEMENTS`: the third makes Newton's matrix singular.

    μ r_N - ‖r_T‖ has a concave kink at r_T = 0. The mean of its gradients around the kink is 0, an element of Clarke's
    hull that shows no descent. Instead the limit of the gradients is used for friction that starts against the slip.
    """
    step = rho[:, 0]
    u = step[:, None] * u
    slip, t = _direction(u[:, 1:])
    friction, d = _direction(r[:, 1:])
    d = np.where(friction[:, None] > 0.0, d, -t)
    cross = u[:, 1] * r[:, 2] - u[:, 2] * r[:, 1]
    along = u[:, 1] * r[:, 1] + u[:, 2] * r[:, 2]
    slack = mu * r[:, 0] - friction
    F = np.column_stack((np.minimum(u[:, 0], r[:, 0]), np.minimum(slip, slack), np.abs(cross) + np.maximum(along, 0.0)))
    F_u, F_r = np.zeros((mu.size, 3, 3)), np.zeros((mu.size, 3, 3))
    opens = u[:, 0] < r[:, 0]
    F_u[:, 0, 0], F_r[:, 0, 0] = opens, ~opens
    sticks = (slip < slack)[:, None]
    F_u[:, 1, 1:] = np.where(sticks, t, 0.0)
    F_r[:, 1, 1:] = np.where(sticks, 0.0, -d)
    F_r[:, 1, 0] = np.where(sticks[:, 0], 0.0, mu)
    sign, on = np.sign(cross), along > 0.0
    F_u[:, 2, 1], F_u[:, 2, 2] = sign * r[:, 2] + on * r[:, 1], -sign * r[:, 1] + on * r[:, 2]
    F_r[:, 2, 1], F_r[:, 2, 2] = -sign * u[:, 2] + on * u[:, 1], sign * u[:, 1] + on * u[:, 2]
    return F, step[:, None, None] * F_u, F_r


ELEMENTS: dict[str, Callable[[Array, Array, Array, Array], Element]] = {
    "alart-curnier": partial(_element, _kernels.ALART_CURNIER),
    "fischer-burmeister": partial(_element, _kernels.FISCHER_BURMEISTER),
    "jean-moreau": partial(_element, _kernels.JEAN_MOREAU),
    "natural": partial(_element, _kernels.NATURAL),
}
"""The maps (u, r, μ, ρ) → (F, ∂F/∂u, ∂F/∂r) by name."""


def _at(problem: FC3D, r: Array, function: str, rho: Any) -> Element:
    """Map of `ELEMENTS` at an impulse."""
    split = function in ("alart-curnier", "jean-moreau")
    step = _steps(problem, rho) if split else _uniform(problem, rho)[:, None]
    return ELEMENTS[function](*_state(problem, r), problem.mu, step)


def residual_natural_map(problem: FC3D, r: Array, rho: Any = None) -> Array:
    """Natural map r - P_K(r - ρ û), shape (3 nc,), N·s."""
    return _at(problem, r, "natural", rho)[0].ravel()


def residual_jean_moreau(problem: FC3D, r: Array, rho: Any = None) -> Array:
    """(r_N - (r_N - ρ_N u_N)₊, r_T - P_D(r_T - ρ_T u_T)), D of radius μ (r_N)₊, shape (3 nc,), N·s."""
    return _at(problem, r, "jean-moreau", rho)[0].ravel()


def residual_alart_curnier(problem: FC3D, r: Array, rho: Any = None) -> Array:
    """As Jean–Moreau, but D of radius μ (r_N - ρ_N u_N)₊, shape (3 nc,), N·s."""
    return _at(problem, r, "alart-curnier", rho)[0].ravel()


def residual_fischer_burmeister(problem: FC3D, r: Array, rho: Any = None) -> Array:
    """x + y - (x² + y²)^½ in the Jordan algebra of the cone, x = (μ r_N, r_T), y = ρ (û_N, μ u_T), shape (3 nc,), N·s.

    A contact with μ = 0 uses the scalar function of r_N and ρ u_N, and F_T = r_T.
    """
    return _at(problem, r, "fischer-burmeister", rho)[0].ravel()


def residual_hueber_stadler_wohlmuth(problem: FC3D, r: Array, rho: Any = None) -> Array:
    """Alart–Curnier without a quotient: max(μ a, ‖y‖) r_T - μ a₊ y with a = r_N - ρ_N u_N, y = r_T - ρ_T u_T.

    Shape (3 nc,): the normal equation in N·s, the tangential ones in (N·s)².

    References
    ----------
    S. Hüeber, G. Stadler, B. Wohlmuth, A primal-dual active set algorithm for three-dimensional contact problems with
    Coulomb friction, SIAM J. Sci. Comput. 30, 2008.
    """
    u, r = _state(problem, r)
    rho = _steps(problem, rho)
    a = r[:, 0] - rho[:, 0] * u[:, 0]
    y = r[:, 1:] - rho[:, 1:] * u[:, 1:]
    bound = problem.mu * a
    longest = np.maximum(bound, np.hypot(y[:, 0], y[:, 1]))
    tangent = longest[:, None] * r[:, 1:] - np.maximum(bound, 0.0)[:, None] * y
    return np.column_stack((r[:, 0] - np.maximum(a, 0.0), tangent)).ravel()


def residual_xuewen_soh_wanji(problem: FC3D, r: Array, rho: Any = None) -> Array:
    """(min(ρ u_N, r_N), min(ρ‖u_T‖, μ r_N - ‖r_T‖), |ρ u_T × r_T| + max(0, ρ u_T·r_T)), shape (3 nc,).

    Notes
    -----
    The paper prints max(0, u_T1 r_T1) in the last line, which admits friction along the slip if u_T1 = r_T1 = 0; the
    scalar product does not.

    References
    ----------
    N. Pop, Bundle methods for a quasistatic contact problem, equation (3.22), after L. Xuewen, A.-K. Soh, C. Wanji,
    A new nonsmooth model for three-dimensional frictional contact problems, Comput. Mech. 26, 2000.
    """
    return xuewen_soh_wanji(*_state(problem, r), problem.mu, _uniform(problem, rho)[:, None])[0].ravel()


def residual_soccp(problem: FC3D, r: Array) -> Array:
    """Second-order cone complementarity, shape (9 nc,): x ∘ y, û - P_K*(û), r - P_K(r).

    x = (û_N, μ u_T) and y = (μ r_N, r_T) lie in the Lorentz cone; their Jordan product in J is
    (xᵀy, y_N x_T + x_N y_T). For μ = 0 the normal part of y is r_N.
    """
    u, r = _state(problem, r)
    mu, hat = problem.mu, cones.saxce(u, problem.mu)
    x = np.column_stack((hat[:, 0], mu[:, None] * u[:, 1:]))
    y = np.column_stack((np.where(mu > 0.0, mu, 1.0) * r[:, 0], r[:, 1:]))
    product = np.column_stack(((x * y).sum(axis=1), y[:, :1] * x[:, 1:] + x[:, :1] * y[:, 1:]))
    return np.concatenate([a.ravel() for a in (product, hat - cones.project_dual(hat, mu), r - cones.project(r, mu))])


def residual_normal_map(problem: FC3D, z: Array, rho: Any = None) -> Array:
    """ρ û(P_K(z)) + z - P_K(z), shape (3 nc,), N·s: zero at z = r - ρ û(r), and then r = P_K(z) is a solution."""
    z = np.asarray(z, dtype=float).reshape(-1, 3)
    r = cones.project(z, problem.mu)
    u = problem.velocity(r.ravel()).reshape(-1, 3)
    return (_uniform(problem, rho)[:, None] * cones.saxce(u, problem.mu) + z - r).ravel()


def quasi_variational_gap(problem: FC3D, r: Array, rho: Any = None) -> Array:
    """Regularised gap max over s ∈ C(r_N) of u·(r - s) - ‖r - s‖²/(2ρ) of each contact, shape (nc,), J.

    C(r_N) = {s_N ≥ 0, ‖s_T‖ ≤ μ (r_N)₊} is the cylinder that moves with r. The maximum is at s = P_C(r - ρ u). For
    r ∈ C(r_N) it is not negative, and it is zero if and only if u·(s - r) ≥ 0 for all s ∈ C(r_N).

    References
    ----------
    M. Fukushima, Equivalent differentiable optimization problems and descent methods for asymmetric variational
    inequality problems, Math. Program. 53, 1992.
    """
    u, r = _state(problem, r)
    rho = _steps(problem, rho)
    s = r - ELEMENTS["jean-moreau"](u, r, problem.mu, rho)[0]  # the projection on the half-line times the disk
    away = r - s
    scaled = away / np.column_stack((rho, rho[:, 1]))
    return np.asarray((u * away).sum(axis=1) - 0.5 * (away * scaled).sum(axis=1))


def residual_quasi_variational_inequality(problem: FC3D, r: Array, rho: Any = None) -> Array:
    """Quasi-variational inequality r ∈ C(r_N), u·(s - r) ≥ 0 for all s ∈ C(r_N), shape (4 nc,).

    Returns `quasi_variational_gap` in J, then r - P_C(r) in N·s, C(r_N) = {s_N ≥ 0, ‖s_T‖ ≤ μ (r_N)₊}. The operator
    u = W r + q is affine and monotone, but the set moves with r. The natural map r - P_C(r - ρ u) of the inequality is
    `residual_jean_moreau`.
    """
    r, ones = np.asarray(r, dtype=float), np.ones((problem.nc, 2))
    feasible = ELEMENTS["jean-moreau"](np.zeros((problem.nc, 3)), r.reshape(-1, 3), problem.mu, ones)[0]
    return np.concatenate((quasi_variational_gap(problem, r, rho), feasible.ravel()))


def residual_bipotential(problem: FC3D, r: Array) -> Array:
    """De Saxcé's bipotential b(-u, r) + u·r and its constraints, shape (5 nc,).

    b(-u, r) = μ r_N ‖u_T‖ if u_N ≥ 0 and r ∈ K, otherwise infinite. b(-u, r) + u·r ≥ 0, with equality exactly for pairs
    of Coulomb's law. Returns μ r_N ‖u_T‖ + u·r = r·û in J, then (-u_N)₊ in m/s, then r - P_K(r) in N·s.

    References
    ----------
    G. de Saxcé, Z.-Q. Feng, The bipotential method, Math. Comput. Modelling 28, 1998.
    """
    u, r = _state(problem, r)
    value = (r * cones.saxce(u, problem.mu)).sum(axis=1)
    return np.concatenate((value, np.maximum(-u[:, 0], 0.0), (r - cones.project(r, problem.mu)).ravel()))


def jacobian(problem: FC3D, r: Array, function: str, rho: Any = None) -> sp.csr_array:
    """Element ∂F/∂r + (∂F/∂u) W of the generalised Jacobian of a map of `ELEMENTS`, shape (3 nc, 3 nc)."""
    _, F_u, F_r = _at(problem, r, choice(function, sorted(ELEMENTS), "function"), rho)
    return sp.csr_array(block_diagonal(F_r) + block_diagonal(F_u) @ problem.W)


def block_diagonal(blocks: Array) -> sp.bsr_array:
    """Block-diagonal sparse matrix of blocks (nc, 3, 3)."""
    nc = blocks.shape[0]
    return sp.bsr_array((blocks, np.arange(nc), np.arange(nc + 1)), shape=(3 * nc, 3 * nc))


def with_blocks(W: Any, blocks: Array) -> Any:
    """Return W, dense or sparse, with blocks (nc, 3, 3) or (3, 3) added to its diagonal blocks."""
    nc = W.shape[0] // 3
    blocks = np.broadcast_to(blocks, (nc, 3, 3))
    if sp.issparse(W):
        return W + block_diagonal(blocks)
    out, c = W.copy(), np.arange(nc)
    out.reshape(nc, 3, nc, 3)[c, :, c] += blocks
    return out
