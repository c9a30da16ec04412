"""Second-order cone of Coulomb friction, one contact at a time: projection, Jacobian, exact one-contact problem."""

import math

from nsdyn._kernels.compiled import kernel, no_alloc
from nsdyn._kernels.vectors import square

ROUNDING = 2.0**-52


@no_alloc(inline="always")
def project(zn, z1, z2, mu):
    """Return the projection of (zn, z1, z2) on K = {|r_T| <= mu r_N}: three scalars."""
    t = math.sqrt(z1 * z1 + z2 * z2)
    if zn >= 0.0 and t <= mu * zn:  # zn >= 0 matters for mu = 0
        return zn, z1, z2
    if mu * t <= -zn:
        return 0.0, 0.0, 0.0
    pn = (zn + mu * t) / (1.0 + mu * mu)
    s = mu * pn / t if t > 0.0 else 0.0
    return pn, s * z1, s * z2


@no_alloc
def projection_jacobian(zn, z1, z2, mu, D):
    """Write an element of the generalised Jacobian of the projection at z into D (3, 3); symmetric, between 0 and I."""
    D[:] = 0.0
    t = math.sqrt(z1 * z1 + z2 * z2)
    if zn >= 0.0 and t <= mu * zn:
        D[0, 0] = D[1, 1] = D[2, 2] = 1.0
    elif mu * t > -zn:
        c = 1.0 / (1.0 + mu * mu)
        a, b = z1 / t, z2 / t
        d = mu * c * (zn + mu * t) / t
        e = c * mu * mu - d
        D[0, 0] = c
        D[0, 1] = D[1, 0] = c * mu * a
        D[0, 2] = D[2, 0] = c * mu * b
        D[1, 1] = d + e * a * a
        D[2, 2] = d + e * b * b
        D[1, 2] = D[2, 1] = e * a * b


@no_alloc
def into_cones(r, mu, out):
    """Write P_K(r) into out (3 nc,); return whether it differs from r by more than round-off."""
    moved = False
    for c in range(mu.size):
        i = 3 * c
        a, b, d = project(r[i], r[i + 1], r[i + 2], mu[c])
        change = max(abs(a - r[i]), abs(b - r[i + 1]), abs(d - r[i + 2]))
        moved = moved or not change <= 4.0 * ROUNDING * max(abs(r[i]), abs(r[i + 1]), abs(r[i + 2]))
        out[i], out[i + 1], out[i + 2] = a, b, d
    return moved


@no_alloc
def jacobians(z, mu, D):
    """Write the `projection_jacobian` at z (nc, 3) of every contact into D (nc, 3, 3)."""
    for c in range(mu.size):
        projection_jacobian(z[c, 0], z[c, 1], z[c, 2], mu[c], D[c])


@no_alloc
def measures(W_diagonal, u, r, mu):
    """Return (error, residual) of an impulse r and its velocity u.

    The error is |r - P_K(r - u_hat)|_2 over all contacts, the numerator of the literature's error. The residual is the
    largest |r - P_K(r - rho u_hat)| / rho, with rho = 1 / W_diagonal[c], in m/s. It is at least -u_N, of which the
    distance of u_hat from K* is only the part 1 / (1 + mu^2)^(1/2), and the rounding of W_cc r_c, since impulses so
    large that q vanishes in the round-off of u = W r + q solve nothing.
    """
    total, worst = 0.0, 0.0
    for c in range(mu.size):
        i, rho = 3 * c, 1.0 / W_diagonal[c]
        s = mu[c] * math.sqrt(u[i + 1] * u[i + 1] + u[i + 2] * u[i + 2])
        if r[i] == r[i + 1] == r[i + 2] == 0.0 and u[i] >= 0.0 and s >= 0.0:  # open; a NaN fails this test
            continue
        pn, p1, p2 = project(r[i] - u[i] - s, r[i + 1] - u[i + 1], r[i + 2] - u[i + 2], mu[c])
        total += square(r[i] - pn) + square(r[i + 1] - p1) + square(r[i + 2] - p2)
        pn, p1, p2 = project(r[i] - rho * (u[i] + s), r[i + 1] - rho * u[i + 1], r[i + 2] - rho * u[i + 2], mu[c])
        e = math.sqrt(square(r[i] - pn) + square(r[i + 1] - p1) + square(r[i + 2] - p2)) / rho
        floor = max(-u[i], ROUNDING * math.sqrt(square(r[i]) + square(r[i + 1]) + square(r[i + 2])) / rho)
        e = floor if e < floor else e
        if not e <= worst:  # a NaN is the worst
            worst = e
    return math.sqrt(total), worst


@no_alloc
def measure_at(W_diagonal, u, r, mu, q_norm):
    """Return the larger of the literature's error and the residual in m/s of an impulse r and its velocity u."""
    error, residual = measures(W_diagonal, u, r, mu)
    return max(residual, error / q_norm)


@no_alloc
def round_off(W_diagonal, q, r, q_norm):
    """Return the round-off in the measures of an impulse r: see `FC3D.round_off`."""
    most, total = 0.0, 0.0
    for i in range(r.size):
        most = max(most, abs(q[i]) + W_diagonal[i // 3] * abs(r[i]))
        total += r[i] * r[i]
    return ROUNDING * max(4.0 * most, math.sqrt(total) / q_norm)


@no_alloc
def duality_gap(u, r, mu):
    """Return (Σ r·(u + (delta + mu |u_T|) e_N), |delta|_2) with delta = max(0, -u_N) and r projected on its cone."""
    gap, shift = 0.0, 0.0
    for c in range(mu.size):
        i = 3 * c
        rn, r1, r2 = project(r[i], r[i + 1], r[i + 2], mu[c])
        slip = math.sqrt(u[i + 1] * u[i + 1] + u[i + 2] * u[i + 2])
        gap += rn * (max(u[i], 0.0) + mu[c] * slip) + r1 * u[i + 1] + r2 * u[i + 2]
        shift += square(min(u[i], 0.0))
    return max(gap, 0.0), math.sqrt(shift)


@no_alloc
def _slip(W, q0, q1, q2, alpha):
    """Return the impulse with u_N = 0 and u_T = -alpha r_T: r_N, r_T1, r_T2."""
    a, b, c, d = W[1, 1] + alpha, W[1, 2], W[2, 1], W[2, 2] + alpha
    det = max(a * d - b * c, ROUNDING * a * d)
    # r_T = x + y r_N solves (W_TT + alpha I) r_T = -(q_T + W_TN r_N)
    x1, x2 = -(d * q1 - b * q2) / det, -(a * q2 - c * q1) / det
    y1, y2 = -(d * W[1, 0] - b * W[2, 0]) / det, -(a * W[2, 0] - c * W[1, 0]) / det
    # The Schur complement of W_TT is 0 where one coordinate moves the point, whatever its direction.
    left = max(W[0, 0] + W[0, 1] * y1 + W[0, 2] * y2, ROUNDING * W[0, 0])
    rn = -(q0 + W[0, 1] * x1 + W[0, 2] * x2) / left
    return rn, x1 + y1 * rn, x2 + y2 * rn


@no_alloc
def _quartic(W, q0, q1, q2, mu):
    """Find the root alpha of |r_T| = mu r_N along `_slip` by Newton's method, which may fail.

    By Cramer's rule r_N = P / D and r_T = T / D with P quadratic and T linear in alpha. Newton's method is applied to
    1 - mu P / |T|, which is linear where the contact is isotropic. It starts from the root of the asymptote.
    """
    p1 = W[0, 1] * q1 + W[0, 2] * q2 - q0 * (W[1, 1] + W[2, 2])
    p0 = (
        q1 * (W[0, 1] * W[2, 2] - W[0, 2] * W[2, 1])
        + q2 * (W[0, 2] * W[1, 1] - W[0, 1] * W[1, 2])
        - q0 * (W[1, 1] * W[2, 2] - W[1, 2] * W[2, 1])
    )
    across = W[1, 0] * q2 - W[2, 0] * q1
    b1, b2 = W[1, 0] * q0 - W[0, 0] * q1, W[2, 0] * q0 - W[0, 0] * q2
    a1 = W[2, 2] * b1 - W[1, 2] * b2 - W[0, 2] * across
    a2 = W[1, 1] * b2 - W[2, 1] * b1 + W[0, 1] * across
    size, along = b1 * b1 + b2 * b2, a1 * b1 + a2 * b2
    alpha = max(0.0, (p1 - math.sqrt(size) / mu) / q0 + along / size) if size > 0.0 else 0.0
    for _ in range(8):
        P, T1, T2 = p0 + alpha * (p1 - alpha * q0), a1 + alpha * b1, a2 + alpha * b2
        square = T1 * T1 + T2 * T2
        turn = mu * (P * (T1 * b1 + T2 * b2) - square * (p1 - 2.0 * alpha * q0))
        if turn == 0.0:
            break
        step = square * (math.sqrt(square) - mu * P) / turn
        alpha -= step
        if not abs(step) > 1e-9 * alpha:  # its square is round-off
            break
    return alpha


@no_alloc
def slide(W, q0, q1, q2, mu):
    """Solve `coulomb` for a contact that neither takes off nor sticks: the root of |r_T| = mu r_N along `_slip`.

    If Newton's method does not find it, the root is bracketed in beta = alpha / (alpha + tau) in [0, 1): at beta = 0
    the impulse is outside the cone, at beta = 1 it is normal.
    """
    alpha = _quartic(W, q0, q1, q2, mu)
    if 0.0 < alpha < 1e300:
        rn, r1, r2 = _slip(W, q0, q1, q2, alpha)
        t = math.sqrt(r1 * r1 + r2 * r2)
        if abs(t - mu * rn) <= 1e-14 * t and t > 0.0:
            s = mu * rn / t
            return rn, s * r1, s * r2
    tau = 0.5 * (W[1, 1] + W[2, 2])
    rn, r1, r2 = _slip(W, q0, q1, q2, _least(W))
    t = math.sqrt(r1 * r1 + r2 * r2)
    # f = (|r_T| - mu r_N) / (|r_T| + mu |r_N|) falls from f_lo in (0, 1] at lo to -1 at hi.
    lo, f_lo, hi, f_hi = 0.0, (t - mu * rn) / (t + mu * abs(rn)), 1.0, -1.0
    side = 0
    for k in range(100):
        # Illinois steps, a bisection every third
        beta = (lo * f_hi - hi * f_lo) / (f_hi - f_lo) if k % 3 else 0.5 * (lo + hi)
        if not lo < beta < hi:
            beta = 0.5 * (lo + hi)
            if not lo < beta < hi:
                break
        rn, r1, r2 = _slip(W, q0, q1, q2, tau * beta / (1.0 - beta))
        t = math.sqrt(r1 * r1 + r2 * r2)
        f = (t - mu * rn) / (t + mu * abs(rn))
        if abs(f) <= 4e-16:
            break
        if f > 0.0:
            lo, f_lo = beta, f
            if side == 1:
                f_hi *= 0.5
            side = 1
        else:
            hi, f_hi = beta, f
            if side == -1:
                f_lo *= 0.5
            side = -1
    t = math.sqrt(r1 * r1 + r2 * r2)
    s = mu * rn / t if t > 0.0 else 0.0
    return rn, s * r1, s * r2


@no_alloc
def _least(W):
    """Return the least alpha of `_slip`: 0, or round-off if W_TT is singular, so that a tangent cannot move."""
    tau = 0.5 * (W[1, 1] + W[2, 2])
    alpha = 1e-14 * tau
    return alpha if W[1, 1] * W[2, 2] - W[1, 2] * W[2, 1] <= alpha * tau else 0.0


@no_alloc
def coulomb(W, q0, q1, q2, mu):
    """Return the exact solution r_N, r_T1, r_T2 of the one-contact problem u = W r + q, K* ∋ u_hat ⟂ r ∈ K.

    The contact takes off if q_N >= 0. Otherwise it sticks if the impulse that stops it lies in the cone. Otherwise it
    slips; the solution is the root of |r_T| = mu r_N along the curve u_N = 0, u_T = -alpha r_T.
    """
    if q0 >= 0.0:
        return 0.0, 0.0, 0.0
    rn, alpha = -q0 / W[0, 0], _least(W)
    if mu == 0.0 or W[1, 1] + W[2, 2] == 0.0 or (alpha > 0.0 and _stops(W, q0, q1, q2, rn)):
        return rn, 0.0, 0.0
    rn, r1, r2 = _slip(W, q0, q1, q2, alpha)
    if math.sqrt(r1 * r1 + r2 * r2) <= mu * rn:
        return rn, r1, r2
    return slide(W, q0, q1, q2, mu)


@no_alloc
def _stops(W, q0, q1, q2, rn):
    """True if the normal impulse r_N alone stops the contact, up to round-off, as in a mechanism of one coordinate.

    The impulse that stops it is not unique there, and that of `_slip` is round-off divided by round-off.
    """
    left = abs(q1 + W[1, 0] * rn) + abs(q2 + W[2, 0] * rn)
    return left <= 1e-13 * (abs(q0) + abs(q1) + abs(q2) + (abs(W[1, 0]) + abs(W[2, 0])) * rn)


@no_alloc
def largest_eigenvalue(W):
    """Return the largest eigenvalue of the symmetric part of a 3x3 block (trigonometric form)."""
    a, b, c = W[0, 0], W[1, 1], W[2, 2]
    d, e, f = 0.5 * (W[0, 1] + W[1, 0]), 0.5 * (W[1, 2] + W[2, 1]), 0.5 * (W[0, 2] + W[2, 0])
    off = d * d + e * e + f * f
    mean = (a + b + c) / 3.0
    p = math.sqrt((square(a - mean) + square(b - mean) + square(c - mean) + 2.0 * off) / 6.0)
    if p == 0.0:
        return mean
    a, b, c, d, e, f = (a - mean) / p, (b - mean) / p, (c - mean) / p, d / p, e / p, f / p
    half_det = 0.5 * (a * (b * c - e * e) - d * (d * c - e * f) + f * (d * e - b * f))
    return mean + 2.0 * p * math.cos(math.acos(min(1.0, max(-1.0, half_det))) / 3.0)


@kernel
def diagonal_scales(indptr, indices, data, out):
    """Write lambda_max of the diagonal block of every contact of a block-sparse W into out (nc,)."""
    for c in range(out.size):
        out[c] = 0.0
        for k in range(indptr[c], indptr[c + 1]):
            if indices[k] == c:
                out[c] = largest_eigenvalue(data[k])
