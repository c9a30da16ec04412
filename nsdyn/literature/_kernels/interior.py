"""Interior point method for K* ∋ u + μ‖u_T‖ e_N ⟂ r ∈ K, Coulomb's law as it is (nonassociated): loops over contacts.

Per contact x = (u_N / μ + ‖u_T‖, u_T) and z = (μ r_N, r_T) lie in the Lorentz cone, and x ∘ z = σ e on the central
path. With Nesterov and Todd's matrix T (T z = T⁻¹ x = λ) the Newton step along the path reads dr = E T⁻¹ d - A du,

    A = E T⁻² C,   E = diag(1/μ, 1, 1),   C = [[1/μ, tᵀ], [0, I]],   t = u_T / ‖u_T‖.

So (I + A W) p = g gives du = W p - F, with g = E T⁻¹ d + A F and F the defect u - W r - q. u stays linear in the
step; its only constraint is u_N > 0. z moves along the cone, because the direction of slip may turn. All quantities
are in units in which max |q| = 1 and the mean of λ_max(W_cc) = 1. A contact with μ = 0 has only its normal component:
the tangents of its x and z are 0, and remain so.
"""

import math

from nsdyn._kernels.compiled import no_alloc
from nsdyn._kernels.vectors import dot, minus, put, row, square, three
from nsdyn._kernels.vectors import to_world as product

START = 100.0  # first x and z: far inside the cones, whatever the solution of a problem of unit size


@no_alloc
def start(q, mu, u, z):
    """Set the first point: u_T = q_T, all other quantities far inside the cones."""
    for c in range(mu.size):
        u[c, 0] = START * (mu[c] if mu[c] > 0.0 else 1.0)
        u[c, 1], u[c, 2] = q[3 * c + 1], q[3 * c + 2]
        z[c, 0], z[c, 1], z[c, 2] = START, 0.0, 0.0


@no_alloc
def impulse(z, mu, unit, r):
    """Convert z to impulses in units of `unit`, into r (3 nc,)."""
    for c in range(mu.size):
        r[3 * c] = (z[c, 0] / mu[c] if mu[c] > 0.0 else z[c, 0]) * unit
        r[3 * c + 1], r[3 * c + 2] = z[c, 1] * unit, z[c, 2] * unit


@no_alloc
def defect(u, v, mu, F):
    """Compute F = u - v for v = W r + q, into F (nc, 3); return its largest entry."""
    worst = 0.0
    for c in range(mu.size):
        for i in range(3):
            F[c, i] = u[c, i] - v[3 * c + i] if i == 0 or mu[c] > 0.0 else 0.0
            worst = max(worst, abs(F[c, i]))
    return worst


@no_alloc
def root(x):
    """Return (x_0² - ‖x_T‖²)^½ of a point of the Lorentz cone, kept above round-off."""
    t = math.sqrt(x[1] * x[1] + x[2] * x[2])
    return math.sqrt(max(x[0] - t, 1e-16 * x[0]) * (x[0] + t))


@no_alloc
def nesterov_todd(x, z, dx, dz, T, V):
    """Compute the symmetric T with T z = T⁻¹ x of two points of the Lorentz cone and V = T⁻¹, into T and V (3, 3).

    dx and dz are the `root` of x and z.
    """
    g = math.sqrt(0.5 * (1.0 + dot(x, z) / (dx * dz)))
    w0, w1, w2 = (x[0] / dx + z[0] / dz) / (2 * g), (x[1] / dx - z[1] / dz) / (2 * g), (x[2] / dx - z[2] / dz) / (2 * g)
    eta = math.sqrt(dx / dz)
    k = 1.0 / (1.0 + w0)
    for B, e, s in ((T, eta, 1.0), (V, 1.0 / eta, -1.0)):
        B[0, 0] = e * w0
        B[0, 1] = B[1, 0] = e * s * w1
        B[0, 2] = B[2, 0] = e * s * w2
        B[1, 1] = e * (1.0 + k * w1 * w1)
        B[2, 2] = e * (1.0 + k * w2 * w2)
        B[1, 2] = B[2, 1] = e * k * w1 * w2


@no_alloc
def scaled_point(x, z, dx, dz, lam):
    """Compute λ = T z = T⁻¹ x of `nesterov_todd`, into lam (3,), inside the cone also for points on its boundary."""
    g, e = math.sqrt(0.5 * (1.0 + dot(x, z) / (dx * dz))), math.sqrt(dx * dz)
    x0, z0 = x[0] / dx, z[0] / dz
    a, b = (g + z0) / (x0 + z0 + 2.0 * g) / dx, (g + x0) / (x0 + z0 + 2.0 * g) / dz
    lam[0] = e * g
    lam[1], lam[2] = e * (a * x[1] + b * z[1]), e * (a * x[2] + b * z[2])


@no_alloc
def scalings(x, z, T, V, lam):
    """Apply `nesterov_todd` to many points (n, 3), and compute λ = T z."""
    for c in range(x.shape[0]):
        a, b = row(x, c), row(z, c)
        nesterov_todd(a, b, root(a), root(b), T[c], V[c])
        scaled_point(a, b, root(a), root(b), lam[c])


@no_alloc
def scaling(u, z, mu, T, V, C, A, lam):
    """Compute T, V = T⁻¹, C, A and λ = T z of every contact; return the mean of x·z."""
    total = 0.0
    for c in range(mu.size):
        m = mu[c] if mu[c] > 0.0 else 1.0
        x1, x2 = (u[c, 1], u[c, 2]) if mu[c] > 0.0 else (0.0, 0.0)
        t = math.sqrt(x1 * x1 + x2 * x2)
        x0 = u[c, 0] / m + t
        x, y = (x0, x1, x2), row(z, c)
        total += dot(x, y)
        dx, dy = math.sqrt(u[c, 0] / m * (x0 + t)), root(y)
        nesterov_todd(x, y, dx, dy, T[c], V[c])
        scaled_point(x, y, dx, dy, lam[c])
        C[c] = 0.0
        A[c] = 0.0
        C[c, 0, 0] = 1.0 / m
        if mu[c] > 0.0:
            C[c, 1, 1] = C[c, 2, 2] = 1.0
            if t > 0.0:
                C[c, 0, 1], C[c, 0, 2] = x1 / t, x2 / t
        for i in range(3):
            e = 1.0 / m if i == 0 else 1.0
            for j in range(3):
                for l in range(3):
                    square = V[c, i, 0] * V[c, 0, l] + V[c, i, 1] * V[c, 1, l] + V[c, i, 2] * V[c, 2, l]
                    A[c, i, j] += e * square * C[c, l, j]
    return total / mu.size


@no_alloc
def target(lam, T, V, dx, dz, sigma, correct, d):
    """Solve λ ∘ d = σ e - λ ∘ λ - (T⁻¹ dx) ∘ (T dz), the last term (Mehrotra's) only when `correct`."""
    for c in range(lam.shape[0]):
        l0, l1, l2 = lam[c, 0], lam[c, 1], lam[c, 2]
        b0 = sigma - (l0 * l0 + l1 * l1 + l2 * l2)
        b1, b2 = -2.0 * l0 * l1, -2.0 * l0 * l2
        if correct:
            p0, p1, p2 = product(V, c, row(dx, c))
            q0, q1, q2 = product(T, c, row(dz, c))
            b0 -= p0 * q0 + p1 * q1 + p2 * q2
            b1 -= p0 * q1 + q0 * p1
            b2 -= p0 * q2 + q0 * p2
        t = math.sqrt(l1 * l1 + l2 * l2)
        d[c, 0] = (l0 * b0 - l1 * b1 - l2 * b2) / (max(l0 - t, 1e-16 * l0) * (l0 + t))
        d[c, 1] = (b1 - d[c, 0] * l1) / l0
        d[c, 2] = (b2 - d[c, 0] * l2) / l0


@no_alloc
def right_side(mu, V, A, d, F, g):
    """Compute G = E T⁻¹ d + A F, into g (3 nc,)."""
    for c in range(mu.size):
        one, other = product(V, c, row(d, c)), product(A, c, row(F, c))
        for i in range(3):
            e = 1.0 / mu[c] if i == 0 and mu[c] > 0.0 else 1.0
            g[3 * c + i] = e * one[i] + other[i]


@no_alloc
def recover(mu, V, C, d, F, Wp, du, dx, dz):
    """Set du = W p - F, dx = C du, dz = T⁻¹ (d - T⁻¹ dx).

    Parameters
    ----------
    mu : ndarray, shape (nc,)
    V, C : ndarray, shape (nc, 3, 3)
        T⁻¹ of the scaling, and the blocks that map u to x.
    d, F : ndarray, shape (nc, 3)
        Result of `target`, and the residual.
    Wp : ndarray, shape (3 nc,)
    du, dx, dz : ndarray, shape (nc, 3)
    """
    for c in range(mu.size):
        put(du, c, minus(three(Wp, 3 * c), row(F, c)))
        put(dx, c, product(C, c, row(du, c)))
        put(dz, c, product(V, c, minus(row(d, c), product(V, c, row(dx, c)))))


@no_alloc
def longest(u, z, du, dz):
    """Return the largest step for which u_N, z_N and the slack z_N - ‖z_T‖ (to first order) do not become negative."""
    a = 1e300
    for c in range(u.shape[0]):
        if du[c, 0] < 0.0:
            a = min(a, -u[c, 0] / du[c, 0])
        if dz[c, 0] < 0.0:
            a = min(a, -z[c, 0] / dz[c, 0])
        t = math.sqrt(square(z[c, 1]) + square(z[c, 2]))
        slack = dz[c, 0]
        if t > 0.0:
            slack -= (z[c, 1] * dz[c, 1] + z[c, 2] * dz[c, 2]) / t
        if slack < 0.0:
            a = min(a, (t - z[c, 0]) / slack)
    return a


@no_alloc
def move(mu, u, z, du, dz, a, nu, nz):
    """Compute the points after a step a, into nu and nz; return the mean of x·z there.

    If the straight step leaves less than half the slack of the linear model, z_T is shortened: the cone is round and
    the direction of slip has turned.
    """
    total = 0.0
    for c in range(mu.size):
        t = math.sqrt(square(z[c, 1]) + square(z[c, 2]))
        slack = z[c, 0] - t + a * dz[c, 0]
        if t > 0.0:
            slack -= a * (z[c, 1] * dz[c, 1] + z[c, 2] * dz[c, 2]) / t
        for i in range(3):
            nu[c, i] = u[c, i] + a * du[c, i]
            nz[c, i] = z[c, i] + a * dz[c, i]
        t = math.sqrt(square(nz[c, 1]) + square(nz[c, 2]))
        if nz[c, 0] - t < 0.5 * slack and t > 0.0:
            s = (nz[c, 0] - min(slack, 0.9 * nz[c, 0])) / t
            nz[c, 1] *= s
            nz[c, 2] *= s
        if mu[c] > 0.0:
            total += (nu[c, 0] / mu[c] + math.sqrt(square(nu[c, 1]) + square(nu[c, 2]))) * nz[c, 0]
            total += nu[c, 1] * nz[c, 1] + nu[c, 2] * nz[c, 2]
        else:
            total += nu[c, 0] * nz[c, 0]
    return total / mu.size


@no_alloc
def centring(gap, after, full, worst, last):
    """Return the target share of the gap, from the affine step `full`, the defect `worst` and the last step `last`."""
    if last < 0.1:  # the last step hit the boundary almost immediately
        return 1.0
    left, rest = after / gap, 1.0 - full
    return max(min(1.0, square(left) * left), 1e-4, 0.5 * square(rest) * rest, min(1.0, 0.1 * worst / gap))
