"""Smoothed law of Coulomb in the variable of the normal map, z = r - κ u with κ > 0 per contact: contact loops.

For τ > 0 the law is replaced by

    u_N r_N = τ,   u_T + λ r_T = 0,   λ (μ² r_N² - ‖r_T‖²) = 2 τ,

which for any z has one solution (r, u) inside the cones, and the law itself is its limit τ → 0. A contact with μ = 0
has only its normal component. With k = r_N / u_N, D = 2 τ / λ, f = 2 λ / D, and a compliance R of damping, which adds
R dr to the velocity of a step, the linearised law reads dr = -A (du - R dr),

    A_NN = k / (1 + k R),   A_TT = [(λ + R) I + f r_T r_Tᵀ]⁻¹,   A_TN = A_TT f μ² r_N r_T A_NN.
"""

import math

from nsdyn._kernels.compiled import kernel


@kernel(inline="always")
def _short(t, radius, s):
    """e = R - ‖r_T‖ > 0 with (R - e) (1 + s / (e (2 R - e))) = t, R the radius of the disk and s = 2 κ τ.

    The left side is convex in e and falls. With 2 R for 2 R - e the equation is quadratic and its root at most a factor
    of two too small: from there Newton's steps grow towards the root.
    """
    half = 0.5 * s / radius
    b, c = t + half - radius, half * radius
    root = math.sqrt(b * b + 4.0 * c)
    e = 2.0 * c / (b + root) if b > 0.0 else 0.5 * (root - b)
    for _ in range(30):
        p, d = radius - e, e * (2.0 * radius - e)
        step = (p * (1.0 + s / d) - t) / (1.0 + s * (radius * radius + p * p) / (d * d))
        e += step
        if not step > 1e-14 * e:
            break
    return e


@kernel
def law(z, mu, kappa, tau, r, u, slip):
    """Solution (r, u) of the smoothed law for z, all (3 nc,), into r and u; λ and D into slip (nc, 2)."""
    for c in range(mu.size):
        i, k = 3 * c, kappa[c]
        root = math.sqrt(z[i] * z[i] + 4.0 * tau * k)
        # The root of r_N² - z_N r_N = τ κ without cancellation
        r[i] = 0.5 * (z[i] + root) if z[i] > 0.0 else 2.0 * tau * k / (root - z[i])
        u[i] = tau / r[i]
        radius = mu[c] * r[i]
        if radius == 0.0:
            r[i + 1] = r[i + 2] = u[i + 1] = u[i + 2] = 0.0
            continue
        t = math.sqrt(z[i + 1] * z[i + 1] + z[i + 2] * z[i + 2])
        e = _short(t, radius, 2.0 * k * tau)
        d = e * (2.0 * radius - e)
        l = 2.0 * tau / d
        slip[c, 0], slip[c, 1] = l, d
        for j in (i + 1, i + 2):
            r[j] = z[j] / (1.0 + k * l)
            u[j] = -l * r[j]


@kernel
def tangent(r, u, slip, mu, scales, damping, A):
    """A of every contact with the compliance R = λ_max(W_cc) / damping, into A (nc, 3, 3)."""
    for c in range(mu.size):
        i, B = 3 * c, A[c]
        B[:] = 0.0
        soft = scales[c] / damping
        B[0, 0] = r[i] / (u[i] + r[i] * soft)
        if mu[c] == 0.0:
            continue
        l, d = slip[c]
        x, y, f = r[i + 1], r[i + 2], 2.0 * l / d
        a = l + soft
        w = f / (a * (a + f * (x * x + y * y)))
        B[1, 1], B[2, 2] = 1.0 / a - w * x * x, 1.0 / a - w * y * y
        B[1, 2] = B[2, 1] = -w * x * y
        g = f * mu[c] * mu[c] * r[i] * B[0, 0]
        B[1, 0] = g * (B[1, 1] * x + B[1, 2] * y)
        B[2, 0] = g * (B[2, 1] * x + B[2, 2] * y)


@kernel
def right_side(x, v, r, u, mu, A, G, g):
    """G = v - u and g = r - x - A G, into G and g."""
    for c in range(mu.size):
        i = 3 * c
        for j in range(3):
            G[i + j] = v[i + j] - u[i + j] if j == 0 or mu[c] > 0.0 else 0.0
        for j in range(3):
            g[i + j] = r[i + j] - x[i + j] - (A[c, j, 0] * G[i] + A[c, j, 1] * G[i + 1] + A[c, j, 2] * G[i + 2])


@kernel
def direction(dv, r, x, G, mu, kappa, scales, damping, A, dx, dz):
    """The step of Newton from dv = W dx: dr = -A (dv + G), dx = dr + r - x, dz = dr - κ (dv + G + R dr)."""
    for c in range(mu.size):
        i, soft = 3 * c, scales[c] / damping
        b0, b1, b2 = dv[i] + G[i], dv[i + 1] + G[i + 1], dv[i + 2] + G[i + 2]
        for j in range(3):
            d = -(A[c, j, 0] * b0 + A[c, j, 1] * b1 + A[c, j, 2] * b2)
            dx[i + j] = d + r[i + j] - x[i + j]
            # Tangents of a contact without friction have no equation.
            b = dv[i + j] + G[i + j] if j == 0 or mu[c] > 0.0 else 0.0
            dz[i + j] = d - kappa[c] * (b + soft * d)


@kernel
def merit(x, v, r, own, u, mu, kappa):
    """Root of (x - r)ᵀ W (x - r) + Σ κ ‖v - u‖², with v = W x + q and own = W r + q."""
    total = 0.0
    for c in range(mu.size):
        for j in range(3 * c, 3 * c + (3 if mu[c] > 0.0 else 1)):
            total += (x[j] - r[j]) * (v[j] - own[j]) + kappa[c] * (v[j] - u[j]) ** 2
        if mu[c] == 0.0:
            for j in (3 * c + 1, 3 * c + 2):
                total += (x[j] - r[j]) * (v[j] - own[j])
    return math.sqrt(max(total, 0.0))
