"""Frozen problems in 80-bit arithmetic: least ‖y‖ with Hᵀ y + b in K*, in coordinates with M = I.

Written apart from the package: dense, by the proximal method of multipliers for the dual problem in the impulse x,
min ½‖H x‖² + b·x over K, whose steps are solved by Newton's method for the projection, with its Jacobian by eigenvalues
of the cone.
"""

import numpy as np

Real = np.longdouble


def solve(A, b):
    """A⁻¹ b by Gauss's elimination with pivots; NumPy's is for doubles."""
    n = len(b)
    T = np.column_stack((A, b))
    for k in range(n):
        p = k + int(np.abs(T[k:, k]).argmax())
        T[[k, p]] = T[[p, k]]
        T[k + 1 :] -= np.outer(T[k + 1 :, k] / T[k, k], T[k])
    x = np.empty(n, Real)
    for k in reversed(range(n)):
        x[k] = (T[k, n] - T[k, k + 1 : n] @ x[k + 1 :]) / T[k, k]
    return x


def project(z, mu):
    """(P_K(z), its Jacobian) for one contact, by the two eigenvalues of z along the edges of K."""
    t = np.sqrt(z[1] ** 2 + z[2] ** 2)
    e = z[1:] / t if t > 0 else np.array([1, 0], Real)
    edge, polar = np.array([1, *(mu * e)], Real), np.array([-mu, *e], Real)
    size = 1 + mu * mu
    along, out = edge @ z / size, polar @ z
    if out <= 0 and z[0] >= 0:
        return z.copy(), np.eye(3, dtype=Real)
    if along <= 0:
        return np.zeros(3, Real), np.zeros((3, 3), Real)
    J = np.outer(edge, edge) / size
    across = np.array([0, -e[1], e[0]], Real)
    if t > 0:
        J += mu * along / t * np.outer(across, across)
    return along * edge, J


def frozen(H, b, mu, x):
    """x ∈ K with Hᵀ H x + b ∈ K* orthogonal to it, from a guess; and what proves it: its gap and its margin.

    Large penalties find it in a few rounds, small ones leave less round-off.
    """
    H, b, x, mu = (np.asarray(a, Real) for a in (H, b, x, mu))
    n, nc, unit = len(H), len(mu), (H * H).sum(axis=0).reshape(-1, 3).sum(axis=1)
    y = H @ x

    def estimate(y):
        z = x.reshape(-1, 3) - steps[:, None] * (H.T @ y + b).reshape(-1, 3)
        parts = [project(z[c], mu[c]) for c in range(nc)]
        P = np.array([p for p, _ in parts])
        return P.ravel(), [J for _, J in parts], (y @ y + ((P * P).sum(axis=1) / steps).sum()) / 2

    least = best = None
    for rho in (1e4, 1e4, 1e4, 1e4, 1e3, 1e2, 1e1, 1e0, 1e-1):
        steps = Real(rho) / unit
        for _ in range(30):
            P, J, value = estimate(y)
            F = y - H @ P
            if np.sqrt(F @ F) <= 1e-18 * np.sqrt(y @ y):
                break
            K = np.eye(n, dtype=Real)
            for c in range(nc):
                K += steps[c] * H[:, 3 * c : 3 * c + 3] @ J[c] @ H[:, 3 * c : 3 * c + 3].T
            step, part = solve(K, -F), Real(1)
            while part > 1e-3 and estimate(y + part * step)[2] > value * (1 + Real(1e-18)):
                part /= 2
            y = y + part * step
            if np.sqrt(step @ step) <= 1e-18 * np.sqrt(y @ y):
                break
        x = estimate(y)[0]
        u = H.T @ (H @ x) + b
        margin = min(u[0::3] - mu * np.sqrt(u[1::3] ** 2 + u[2::3] ** 2))
        off = abs(x @ u) + max(-margin, Real(0))
        if least is None or off < least:
            least, best = off, x
    return best, least


def distance(H, r, x):
    """‖H (r - x)‖."""
    d = np.asarray(H, Real) @ (np.asarray(r, Real) - x)
    return np.sqrt(d @ d)
