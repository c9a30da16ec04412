"""Smoothed Coulomb law in the variable of the normal map, z = r - κ u with κ > 0 per contact: loops over contacts.

For τ > 0 the law is replaced by

    u_N r_N = τ,   u_T + λ r_T = 0,   λ (μ² r_N² - ‖r_T‖²) = 2 τ.

For any z the smoothed law has exactly one solution (r, u) inside the cones. Its limit τ → 0 is Coulomb's law. A contact
with μ = 0 has only its normal component. With D = 2 τ / λ and f = 2 λ / D the law at constant τ reads dr = -A du,

    A_NN = r_N / u_N,   A_TT = [λ I + f r_T r_Tᵀ]⁻¹,   A_TN = A_TT f μ² r_N r_T A_NN,

and at constant z, with dr = κ du,

    dr_N / dlog τ = τ / (u_N + r_N / κ),   dr_T / dlog τ = κ λ (2 μ² r_N dr_N / D - 1) / (1 + κ λ + κ f ‖r_T‖²) r_T.
"""

import math

from nsdyn._kernels.compiled import no_alloc


@no_alloc(inline="always")
def _short(t, radius, s):
    """Return e = R - ‖r_T‖ > 0, the root of (R - e) (1 + s / (e (2 R - e))) = t; R is the disk's radius, s = 2 κ τ.

    The left side is convex and decreasing in e. With 2 R in place of 2 R - e the equation is quadratic, and its root is
    too small by a factor of two at most. From there Newton's iterates grow towards the root.
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


@no_alloc
def law(z, mu, kappa, tau, r, u, slip):
    """Write the solution (r, u) of the smoothed law for z, all (3 nc,), into r and u, and λ and D into slip (nc, 2)."""
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


@no_alloc
def stiffness(r, u, slip, mu, A):
    """Write A of every contact into A (nc, 3, 3)."""
    for c in range(mu.size):
        i, B = 3 * c, A[c]
        B[:] = 0.0
        B[0, 0] = r[i] / u[i]
        if mu[c] == 0.0:
            continue
        l, d = slip[c]
        x, y, f = r[i + 1], r[i + 2], 2.0 * l / d
        w = f / (l * (l + f * (x * x + y * y)))
        B[1, 1], B[2, 2] = 1.0 / l - w * x * x, 1.0 / l - w * y * y
        B[1, 2] = B[2, 1] = -w * x * y
        g = f * mu[c] * mu[c] * r[i] * B[0, 0]
        B[1, 0] = g * (B[1, 1] * x + B[1, 2] * y)
        B[2, 0] = g * (B[2, 1] * x + B[2, 2] * y)


@no_alloc
def product(A, kappa, mu, x, out):
    """Write (A + κ) x of every contact into out (3 nc,). Tangents without friction have no equation and become 0."""
    for c in range(mu.size):
        i, B, k = 3 * c, A[c], kappa[c]
        out[i] = (B[0, 0] + k) * x[i]
        out[i + 1] = out[i + 2] = 0.0
        if mu[c] > 0.0:
            for j in (1, 2):
                out[i + j] = B[j, 0] * x[i] + B[j, 1] * x[i + 1] + B[j, 2] * x[i + 2] + k * x[i + j]


@no_alloc
def rate(r, u, slip, mu, kappa, tau, out):
    """Write dr / dlog τ at constant z into out (3 nc,)."""
    for c in range(mu.size):
        i, k = 3 * c, kappa[c]
        out[i] = tau / (u[i] + r[i] / k)
        out[i + 1] = out[i + 2] = 0.0
        if mu[c] > 0.0:
            (l, d), x, y = slip[c], r[i + 1], r[i + 2]
            g = k * l * (2.0 * mu[c] * mu[c] * r[i] * out[i] / d - 1.0)
            g /= 1.0 + k * l + 2.0 * k * l / d * (x * x + y * y)
            out[i + 1], out[i + 2] = g * x, g * y
