"""Certificate of an impulse along a direction that opens contacts, and Newton's step towards such a direction."""

import math

import numpy as np

from nsdyn._kernels.compiled import kernel, no_alloc
from nsdyn._kernels.problem.blocks import block_product, relative_velocity, relative_velocity_of, weighted_rows
from nsdyn._kernels.problem.cones import ROUNDING, duality_gap, into_cones, project, projection_jacobian
from nsdyn._kernels.reductions import largest
from nsdyn._kernels.vectors import square, three

UNITS = 4.0
"""Round-off of a sum of products, in units of the round-off of its largest product. Some twenty products err at
random."""


@no_alloc(inline="always")
def _opening(o, i, mu):
    """Return κ = o_N - mu |o_T| of the contact whose rows begin at i: o is in κ e_N + K*."""
    return o[i] - mu * math.sqrt(o[i + 1] * o[i + 1] + o[i + 2] * o[i + 2])


@no_alloc
def _step_along(u, s, margin, o, mu, speed):
    """Return a λ ≥ 0 with û + λ o in K* at every contact, û = u + s e_N; inf if neither of two candidates will do.

    The first candidate is the least λ with margin + λ κ ≥ 0, which suffices where û is in margin e_N + K*. The second
    is `speed`.
    """
    least = 0.0
    for c in range(mu.size):
        if margin[c] < 0.0:
            kappa = _opening(o, 3 * c, mu[c])
            least = max(least, -margin[c] / kappa) if kappa > 0.0 else np.inf
    for c in range(mu.size):
        # The contact that decides has margin + λ κ = 0 up to round-off.
        if least < np.inf and margin[c] >= 0.0 and not margin[c] + least * _opening(o, 3 * c, mu[c]) >= 0.0:
            least = np.inf
    if least < np.inf:
        return least
    for c in range(mu.size):
        i = 3 * c
        x, y = u[i + 1] + speed * o[i + 1], u[i + 2] + speed * o[i + 2]
        if not u[i] + s[c] + speed * o[i] >= mu[c] * math.sqrt(x * x + y * y):
            return np.inf
    return speed


@no_alloc
def _round_off(u, r, scales):
    """Return the round-off of velocities in the kinetic norm, √J.

    It adds that of M⁻¹ H_c r_c, up to √λ_max(W_cc) |r_c|, and that of u. An impulse that changes u_c moves the bodies
    by at least 1/√λ_max(W_cc) of the change.
    """
    total = 0.0
    for c in range(scales.size):
        i, scale = 3 * c, math.sqrt(scales[c])
        total += scale * math.sqrt(r[i] * r[i] + r[i + 1] * r[i + 1] + r[i + 2] * r[i + 2])
        total += math.sqrt(u[i] * u[i] + u[i + 1] * u[i + 1] + u[i + 2] * u[i + 2]) / scale
    return UNITS * ROUNDING * total


@kernel
def certificate(u, r, o, mu, scales):
    """Return (gap, |δ|_2, max δ, λ, Σ r·(û + λ o)) of an impulse in K, with o = Hᵀ d; every term of the sum is ≥ 0.

    A max δ below the round-off of u is replaced by that round-off. The squared round-off of the velocity is added to
    the sum.
    """
    gap, shift = duality_gap(u, r, mu)
    least = square(_round_off(u, r, scales))
    if shift == 0.0:
        return gap, shift, 0.0, 0.0, gap + least
    s, margin = np.empty(mu.size), np.empty(mu.size)
    speed = ROUNDING * largest(u)
    for c in range(mu.size):
        margin[c], x, y = three(u, 3 * c)
        s[c] = mu[c] * math.sqrt(x * x + y * y)
        speed = max(speed, -margin[c])
    step, total = frozen(u, s, margin, r, o, mu, speed)
    return gap, shift, speed, step, total + least


@no_alloc
def frozen(u, s, margin, r, o, mu, speed):
    """Return (λ, Σ r·(û + λ o)) with the λ of `_step_along`."""
    step, total = _step_along(u, s, margin, o, mu, speed), 0.0
    if step < np.inf:
        for c in range(mu.size):
            i = 3 * c
            own = r[i] * (u[i] + s[c] + step * o[i])
            own += r[i + 1] * (u[i + 1] + step * o[i + 1]) + r[i + 2] * (u[i + 2] + step * o[i + 2])
            total += max(own, 0.0)  # less is round-off
    return step, total


@kernel
def along_blocks(blocks, d, o):
    """Write Hᵀ d into o (3 nc,); return ‖d‖²_M."""
    offset, _, _, _, m_start, m, _ = blocks
    relative_velocity(blocks, d, o)
    work = np.empty(d.size)
    block_product(offset, m_start, m, d, work)
    total = 0.0
    for i in range(d.size):
        total += d[i] * work[i]
    return total


@kernel
def certificate_of(blocks, u, r, mu, scales, d, out):
    """Write `into_cones` of r into out; return its flag, and for r in K its `certificate` with o = Hᵀ d, and ‖d‖²_M.

    A d with other coordinates opens no contact.
    """
    if into_cones(r, mu, out):
        return True, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    o, square = np.zeros(u.size), 0.0
    if d.size == blocks[0][-1]:
        square = along_blocks(blocks, d, o)
    gap, shift, speed, step, total = certificate(u, out, o, mu, scales)
    return False, gap, shift, speed, step, total, square


@no_alloc(inline="always")
def _pulled(o, b, x, rho, i):
    """Return x + ρ (b - o) of the contact whose rows begin at i."""
    return x[i] + rho * (b[i] - o[i]), x[i + 1] + rho * (b[i + 1] - o[i + 1]), x[i + 2] + rho * (b[i + 2] - o[i + 2])


@no_alloc
def merit(square, o, b, x, rho, mu, P):
    """Return ½‖d‖²_M + Σ ‖P_K(x + ρ (b - o))‖² / 2ρ, with `square` = ‖d‖²_M and o = Hᵀ d.

    The projections go into P (3 nc,).
    """
    total = square
    for c in range(mu.size):
        i, k = 3 * c, rho[c]
        z0, z1, z2 = _pulled(o, b, x, k, i)
        p0, p1, p2 = project(z0, z1, z2, mu[c])
        P[i], P[i + 1], P[i + 2] = p0, p1, p2
        total += (p0 * p0 + p1 * p1 + p2 * p2) / k
    return 0.5 * total


@no_alloc
def curvature(o, b, x, rho, mu, A):
    """Write ρ ∂P_K at x + ρ (b - o) into A (nc, 3, 3). M + Σ H_c A_c H_cᵀ is the second derivative of `merit`."""
    for c in range(mu.size):
        i, k = 3 * c, rho[c]
        z0, z1, z2 = _pulled(o, b, x, k, i)
        B = A[c]
        projection_jacobian(z0, z1, z2, mu[c], B)
        B *= k


@kernel
def least_opening(o, b, mu):
    """Return the largest t with o - b in t e_N + K* at every contact."""
    excess, least = o - b, np.inf
    for c in range(mu.size):
        kappa = _opening(excess, 3 * c, mu[c])
        if not kappa >= least:
            least = kappa
    return least


@kernel
def relax(blocks, mu, b, aim, enough, sweeps, d):
    """Change d (n,) by projections until κ(Hᵀ d - b) ≥ `enough` < `aim` at every contact; return whether it succeeded.

    Contacts with a smaller κ are treated in turn. Each gets the shortest change, in the kinetic norm, that brings the
    linearised κ to `aim`. With o = Hᵀ d - b, the change is along the impulse g = (1, -μ o_T/|o_T|), the gradient of
    κ = o_N - μ|o_T|. Where directions with κ > `aim` exist, every change brings d closer to all of them, and finitely
    many changes suffice.
    """
    offset, block, start, H = blocks[:4]
    y, now = weighted_rows(blocks), False
    # Last change of each block, and change at which each contact was checked: mostly few are left after some sweeps.
    changes, changed, seen = 0, np.zeros(offset.size - 1, np.int64), np.full(mu.size, -1)
    for _ in range(sweeps):
        now = True
        for c in range(mu.size):
            last = 0
            for k in block[c]:
                last = max(last, changed[k] if k >= 0 else 0)
            if seen[c] >= last:
                continue
            o0, o1, o2 = relative_velocity_of(blocks, d, c)
            o0, o1, o2 = o0 - b[3 * c], o1 - b[3 * c + 1], o2 - b[3 * c + 2]
            slip = math.sqrt(o1 * o1 + o2 * o2)
            kappa = o0 - mu[c] * slip
            if kappa >= enough:
                seen[c] = changes
                continue
            now = False
            changes += 1
            g1, g2 = (-mu[c] * o1 / slip, -mu[c] * o2 / slip) if slip > 0.0 else (0.0, 0.0)
            # κ changes by g·W_cc g when d changes by M⁻¹ H g, also for a contact whose sides share a block.
            square = 0.0
            for s in range(2):
                for t in range(2):
                    k = block[c, s]
                    if k >= 0 and k == block[c, t]:
                        n, p, q = offset[k + 1] - offset[k], start[c, s], start[c, t]
                        for j in range(n):
                            change = y[p + j] + g1 * y[p + n + j] + g2 * y[p + 2 * n + j]
                            square += change * (H[q + j] + g1 * H[q + n + j] + g2 * H[q + 2 * n + j])
            if not square > 0.0:
                return False
            z = (aim - kappa) / square
            for s in range(2):
                k = block[c, s]
                if k >= 0:
                    o, n, p, changed[k] = offset[k], offset[k + 1] - offset[k], start[c, s], changes
                    for j in range(n):
                        d[o + j] += z * (y[p + j] + g1 * y[p + n + j] + g2 * y[p + 2 * n + j])
        if now:
            break
    return now
