"""Maps of the literature for one contact with their derivatives, and local solvers for block Gauss–Seidel.

The maps are those of `nsdyn.literature.formulations`, which has their formulas. A local solver takes u = W r + q with
W 3 x 3; `sweep` goes from contact to contact.
"""

import math

import numpy as np

from nsdyn._kernels.compiled import kernel, no_alloc
from nsdyn._kernels.problem.cones import coulomb, project, projection_jacobian
from nsdyn._kernels.problem.given import velocity_of
from nsdyn._kernels.vectors import adjugate, along, dot, minus, row, square, three

PROJECTION, ITERATED, EXACT, ALART_CURNIER, JEAN_MOREAU, NATURAL, FISCHER_BURMEISTER = range(7)


@no_alloc
def _velocity(W, q, r):
    """Return u = W r + q."""
    return dot(row(W, 0), r) + q[0], dot(row(W, 1), r) + q[1], dot(row(W, 2), r) + q[2]


@no_alloc
def _step(r, rho, hat, mu):
    """Return P_K(r - rho û)."""
    z0, z1, z2 = along(r, -rho, hat)
    return project(z0, z1, z2, mu)


@no_alloc
def _shifted(W, q, r, mu):
    """Return û = u + mu |u_T| e_N at u = W r + q."""
    u0, u1, u2 = _velocity(W, q, r)
    return u0 + mu * math.sqrt(u1 * u1 + u2 * u2), u1, u2


@no_alloc
def iterate(W, q, mu, rho, goal, most, r):
    """Fixed point r ← P_K(r - rho û) with Khobotov's step, in place of r; return the number of iterations."""
    x = three(r, 0)
    F = _shifted(W, q, x, mu)
    for k in range(1, most + 1):
        ratio, moved, y, G = 0.0, 0.0, x, F
        for _ in range(50):
            y = _step(x, rho, F, mu)
            way = minus(x, y)
            moved = math.sqrt(dot(way, way))
            if moved <= goal:
                break
            G = _shifted(W, q, y, mu)
            turn = minus(F, G)
            ratio = rho * math.sqrt(dot(turn, turn)) / moved
            if ratio <= 0.9:
                break
            rho *= 2.0 / 3.0
        x, F = y, G
        r[0], r[1], r[2] = x
        if moved <= goal:
            return k
        if ratio < 0.3:
            rho *= 1.5
    return most


@no_alloc
def _disk(predicted, u, r, mu, rho, F, A, B):
    """Alart–Curnier (predicted) and Jean–Moreau with steps of their own along the normal and across it.

    F, A = ∂F/∂u, B = ∂F/∂r; A and B must be zero at entry.
    """
    rn, rt = rho
    a = r[0] - rn * u[0]
    y1, y2 = r[1] - rt * u[1], r[2] - rt * u[2]
    F[0] = r[0] - max(a, 0.0)
    if a > 0.0:
        A[0, 0] = rn
    else:
        B[0, 0] = 1.0
    bound = a if predicted else r[0]
    radius, size = mu * max(bound, 0.0), math.sqrt(y1 * y1 + y2 * y2)
    if size <= radius:
        F[1], F[2] = r[1] - y1, r[2] - y2
        A[1, 1] = A[2, 2] = rt
        return
    t1, t2 = y1 / size, y2 / size
    F[1], F[2] = r[1] - radius * t1, r[2] - radius * t2
    ratio = radius / size
    g11, g12, g22 = ratio * (1.0 - t1 * t1), -ratio * t1 * t2, ratio * (1.0 - t2 * t2)
    A[1, 1], A[1, 2], A[2, 1], A[2, 2] = rt * g11, rt * g12, rt * g12, rt * g22
    B[1, 1], B[1, 2], B[2, 1], B[2, 2] = 1.0 - g11, -g12, -g12, 1.0 - g22
    if bound > 0.0:
        B[1, 0], B[2, 0] = -mu * t1, -mu * t2
        if predicted:
            A[1, 0], A[2, 0] = rn * mu * t1, rn * mu * t2


@no_alloc
def _natural(u, r, mu, rho, F, A, B):
    """Natural map: F, A = ∂F/∂u, B = ∂F/∂r."""
    slip = math.sqrt(u[1] * u[1] + u[2] * u[2])
    z0, z1, z2 = r[0] - rho * (u[0] + mu * slip), r[1] - rho * u[1], r[2] - rho * u[2]
    p0, p1, p2 = project(z0, z1, z2, mu)
    F[0], F[1], F[2] = r[0] - p0, r[1] - p1, r[2] - p2
    projection_jacobian(z0, z1, z2, mu, A)
    for i in range(3):
        for j in range(3):
            B[i, j] = (1.0 if i == j else 0.0) - A[i, j]
            A[i, j] *= rho
        if slip > 0.0:
            A[i, 1] += A[i, 0] * mu * u[1] / slip
            A[i, 2] += A[i, 0] * mu * u[2] / slip


@no_alloc
def _root(s0, s1, s2):
    """Return the square root of (s0, s_T) in the Jordan algebra of the cone."""
    size = math.sqrt(s1 * s1 + s2 * s2)
    low, high = math.sqrt(max(s0 - size, 0.0)), math.sqrt(max(s0 + size, 0.0))
    f = 0.5 * (high - low) / size if size > 0.0 else 0.0
    return 0.5 * (low + high), f * s1, f * s2


@no_alloc
def _one_minus_quotient(w0, w1, w2, x0, x1, x2, out):
    """Compute I - L_w⁻¹ L_x into out; a singular L_w is first shifted by round-off."""
    size = math.sqrt(w1 * w1 + w2 * w2)
    floor = 1e-10 * w0 + 1e-150  # whose square does not vanish where w does
    low, high = max(w0 - size, floor), max(w0 + size, floor)
    a = 0.5 * (low + high)
    f = 0.5 * (high - low) / size if size > 0.0 else 0.0
    b1, b2, det = f * w1, f * w2, low * high
    columns = ((x0, x1, x2), (x1, x0, 0.0), (x2, 0.0, x0))
    for j in range(3):
        y0, y1, y2 = columns[j]
        along = b1 * y1 + b2 * y2
        out[0, j] = -(a * y0 - along) / det
        out[1, j] = -(-b1 * y0 + (det * y1 + b1 * along) / a) / det
        out[2, j] = -(-b2 * y0 + (det * y2 + b2 * along) / a) / det
        out[j, j] += 1.0


@no_alloc
def _fischer_burmeister(u, r, mu, rho, F, A, B):
    """Fischer–Burmeister: F, A = ∂F/∂u, B = ∂F/∂r; A and B must be zero at entry."""
    if mu == 0.0:
        x, y = r[0], rho * u[0]
        w = math.sqrt(x * x + y * y)
        F[0], F[1], F[2] = x + y - w, r[1], r[2]
        w = max(w, 1e-300)
        A[0, 0], B[0, 0], B[1, 1], B[2, 2] = rho * (1.0 - y / w), 1.0 - x / w, 1.0, 1.0
        return
    slip = math.sqrt(u[1] * u[1] + u[2] * u[2])
    x0, x1, x2 = mu * r[0], r[1], r[2]
    y0, y1, y2 = rho * (u[0] + mu * slip), rho * mu * u[1], rho * mu * u[2]
    w0, w1, w2 = _root(
        x0 * x0 + x1 * x1 + x2 * x2 + y0 * y0 + y1 * y1 + y2 * y2,
        2.0 * (x0 * x1 + y0 * y1),
        2.0 * (x0 * x2 + y0 * y2),
    )
    F[0], F[1], F[2] = x0 + y0 - w0, x1 + y1 - w1, x2 + y2 - w2
    _one_minus_quotient(w0, w1, w2, x0, x1, x2, B)
    _one_minus_quotient(w0, w1, w2, y0, y1, y2, A)
    for i in range(3):
        B[i, 0] *= mu
        normal = A[i, 0] * rho
        A[i, 0] = normal
        A[i, 1] = A[i, 1] * rho * mu + (normal * mu * u[1] / slip if slip > 0.0 else 0.0)
        A[i, 2] = A[i, 2] * rho * mu + (normal * mu * u[2] / slip if slip > 0.0 else 0.0)


@no_alloc
def element(kind, u, r, mu, rho, F, A, B):
    """Compute F(u, r), A = ∂F/∂u and B = ∂F/∂r of one of the four maps; return |F|.

    Parameters
    ----------
    kind : int
        ALART_CURNIER, JEAN_MOREAU, NATURAL or FISCHER_BURMEISTER.
    u, r : (float, float, float)
        Relative velocity, m/s, and impulse, N·s.
    mu : float
    rho : (float, float)
        Steps along the normal and across it, kg; the natural map and Fischer–Burmeister's have the first alone.
    F, A, B : ndarray, shapes (3,), (3, 3), (3, 3)
        Results.
    """
    A[:] = 0.0
    B[:] = 0.0
    if kind == NATURAL:
        _natural(u, r, mu, rho[0], F, A, B)
    elif kind == FISCHER_BURMEISTER:
        _fischer_burmeister(u, r, mu, rho[0], F, A, B)
    else:
        _disk(kind == ALART_CURNIER, u, r, mu, rho, F, A, B)
    return math.sqrt(F[0] * F[0] + F[1] * F[1] + F[2] * F[2])


@no_alloc
def elements(kind, u, r, mu, rho, F, A, B):
    """Compute `element` of every contact, with steps rho (nc, 2), into F (nc, 3), A and B (nc, 3, 3)."""
    for c in range(mu.size):
        element(kind, row(u, c), row(r, c), mu[c], (rho[c, 0], rho[c, 1]), F[c], A[c], B[c])


@kernel
def _newton_step(W, A, B, F, r):
    """Update r ← r - (A W + B)⁻¹ F by Cramer's rule; return False if the matrix is singular to round-off."""
    J = np.empty((3, 3))
    top = 0.0
    for i in range(3):
        for j in range(3):
            J[i, j] = A[i, 0] * W[0, j] + A[i, 1] * W[1, j] + A[i, 2] * W[2, j] + B[i, j]
            top = max(top, abs(J[i, j]))
    (x, y, z), det = adjugate(J)
    if not abs(det) > 1e-14 * (square(top) * top):
        return False
    for i in range(3):
        r[i] -= (x[i] * F[0] + y[i] * F[1] + z[i] * F[2]) / det
    return True


@kernel
def newton(kind, W, q, mu, rho, goal, most, r):
    """Take full semismooth Newton steps on one of the four maps, in place of r; return (|F| at the end, iterations).

    Takes at least one step. Otherwise contacts that each meet a goal given from outside would never move again.
    """
    F, A, B = np.empty(3), np.empty((3, 3)), np.empty((3, 3))
    size = element(kind, _velocity(W, q, three(r, 0)), three(r, 0), mu, (rho, rho), F, A, B)
    for k in range(most):
        if (k > 0 and not size > goal) or size == 0.0 or not _newton_step(W, A, B, F, r):
            return size, k
        size = element(kind, _velocity(W, q, three(r, 0)), three(r, 0), mu, (rho, rho), F, A, B)
    return size, most


@kernel(rounds=1000)
def solve(kind, W, q, mu, rho, goal, most, r):
    """Solve the one-contact problem u = W r + q by the local solver `kind`, from r and in place of it.

    If Newton's method misses its goal, one projection replaces its result. Returns the number of local iterations.
    """
    if kind == EXACT:
        r[0], r[1], r[2] = coulomb(W, q[0], q[1], q[2], mu)
        return 1
    if kind == ITERATED:
        return iterate(W, q, mu, rho, goal, most, r)
    start, used = three(r, 0), 0
    if kind != PROJECTION:
        size, used = newton(kind, W, q, mu, rho, goal, most, r)
        if size <= goal:  # false for NaN
            return used
    r[0], r[1], r[2] = _step(start, rho, _shifted(W, q, start, mu), mu)
    return used + 1


@kernel
def sweep(given, q, mu, order, kind, omega, until, r):
    """One sweep of block successive over-relaxation in the given order, in place of r; return the local iterations.

    Each contact solves FC(W_cc/ω, ·): W = (L + D/ω) + (U + (1 - 1/ω) D), so that r stays in the cones for every ω.

    Parameters
    ----------
    given : (indptr, indices, data)
        W in 3 x 3 blocks, of which those of the diagonal have norm 1.
    q, r : ndarray, shape (3 nc,)
    mu : ndarray, shape (nc,)
    order : ndarray of int
        Order in which the contacts are swept.
    kind : int
        Local solver, as in `solve`.
    omega : float
    until : (float, int)
        Change of r, or residual of Newton's equations, at which a local solve ends, and its most iterations.
    """
    (indptr, indices, data), (goal, most) = given, until
    W, b, x, count = np.empty((3, 3)), np.empty(3), np.empty(3), 0
    for c in order:
        i = 3 * c
        for p in range(indptr[c], indptr[c + 1]):
            if indices[p] == c:
                for j in range(3):
                    for k in range(3):
                        W[j, k] = data[p, j, k] / omega
        b[0], b[1], b[2] = velocity_of(given, q, r, c)
        for j in range(3):
            x[j] = r[i + j]
            b[j] -= W[j, 0] * r[i] + W[j, 1] * r[i + 1] + W[j, 2] * r[i + 2]
        count += solve(kind, W, b, mu[c], omega, goal, most, x)
        r[i], r[i + 1], r[i + 2] = x[0], x[1], x[2]
    return count
