"""Free flow of free bodies: straight lines, and rotation that keeps energy and angular momentum.

Euler's equations in principal axes, ω' = (k₁ω₂ω₃, k₂ω₃ω₁, k₃ω₁ω₂), are solved by Gauss collocation of sixth order. It
keeps every quadratic invariant of the body: its energy and the length of its angular momentum L. The direction of L in
space leaves one unknown of the attitude R, the angle ψ about L. Hence R' = R Q(L)ᵀ R_z(Δψ) Q(L') keeps R L as well,
with Q the least rotation of L to a principal axis. The equation ψ' = (ω·L + |L| ω₃)/(|L| + L₃) gives one more unknown
of the collocation.
"""

import math

import numpy as np

from nsdyn._kernels.compiled import kernel, no_alloc
from nsdyn._kernels.vectors import along, dot, four, minus, put, row, three, times, to_local, to_world, turned

PART = 0.5
"""Largest rotation of one collocation, rad: its error is then 1e-9, 1e-7 at worst, after some 13 iterations."""

PARTS = 4096
"""Most collocations in one motion. A motion that needs more, beyond 2000 rad, ends early; invariants are kept."""

_A = np.array(
    [
        [5 / 36, 2 / 9 - math.sqrt(15) / 15, 5 / 36 - math.sqrt(15) / 30],
        [5 / 36 + math.sqrt(15) / 24, 2 / 9, 5 / 36 - math.sqrt(15) / 24],
        [5 / 36 + math.sqrt(15) / 30, 2 / 9 + math.sqrt(15) / 15, 5 / 36],
    ]
)
_B = np.array([5 / 18, 4 / 9, 5 / 18])
_EPS = float(np.finfo(float).eps)


def principal(J):
    """Principal moments (n, 3) and axes (n, 3, 3) of inertias J (n, 3, 3), kg m²: J = axes diag(moments) axesᵀ.

    The axes are the columns of rotations, in body axes. A diagonal inertia keeps its axes and its moments to the last
    bit.
    """
    moments, axes = np.linalg.eigh(J)
    axes *= np.sign(np.linalg.det(axes))[:, None, None]
    # One Newton step to the nearest rotation: axes that are not quite orthogonal make the energy drift at every step.
    fine = axes.astype(np.longdouble)
    axes = (0.5 * fine @ (3.0 * np.eye(3) - fine.swapaxes(1, 2) @ fine)).astype(float)
    for b in range(len(J)):
        diagonal = J[b].diagonal()
        if np.array_equal(J[b], np.diag(diagonal)):
            moments[b], axes[b] = diagonal, np.eye(3)
    return moments, axes


@no_alloc
def _times(q, e, w):
    """Unit quaternion of the product of q and (e, w), which has any length."""
    p, size = turned(q, (e[0], e[1], e[2], w))
    k = 1.0 / size
    return k * p[0], k * p[1], k * p[2], k * p[3]


@no_alloc
def _collocate(I, w, h, stage, slope, e):
    """Torque-free rotation over h in principal axes: write the spin at its end into w, the rotation into e.

    The attitude at the end is R e; e has any length. The axes are named a, b, c in cyclic order, a the one nearest to
    L.
    """
    a, largest = 0, 0.0
    for i in range(3):
        if I[i] * abs(w[i]) > largest:
            a, largest = i, I[i] * abs(w[i])
    b, c = (a + 1) % 3, (a + 2) % 3
    Ia, Ib, Ic, wa, wb, wc = I[a], I[b], I[c], w[a], w[b], w[c]
    ka, kb, kc = (Ib - Ic) / Ia, (Ic - Ia) / Ib, (Ia - Ib) / Ic
    for i in range(3):
        slope[i, 0], slope[i, 1], slope[i, 2] = ka * wb * wc, kb * wc * wa, kc * wa * wb
    last = np.inf
    for _ in range(50):
        for i in range(3):
            x, y, z = h * _A[i, 0], h * _A[i, 1], h * _A[i, 2]
            stage[i, 0] = wa + (x * slope[0, 0] + y * slope[1, 0] + z * slope[2, 0])
            stage[i, 1] = wb + (x * slope[0, 1] + y * slope[1, 1] + z * slope[2, 1])
            stage[i, 2] = wc + (x * slope[0, 2] + y * slope[1, 2] + z * slope[2, 2])
        change = size = 0.0
        for i in range(3):
            x, y, z = stage[i, 0], stage[i, 1], stage[i, 2]
            fa, fb, fc = ka * y * z, kb * z * x, kc * x * y
            change = max(change, abs(fa - slope[i, 0]), abs(fb - slope[i, 1]), abs(fc - slope[i, 2]))
            size = max(size, abs(fa), abs(fb), abs(fc))
            slope[i, 0], slope[i, 1], slope[i, 2] = fa, fb, fc
        # Iterate to round-off: remaining errors would add up in a long run.
        if change <= _EPS * size or change >= last:
            break
        last = change
    # Axis a is oriented along L, so that |L| + L_a is at least |L|.
    La, Lb, Lc = Ia * wa, Ib * wb, Ic * wc
    L, sign = math.sqrt(La * La + Lb * Lb + Lc * Lc), math.copysign(1.0, La)
    psi = 0.0
    for i in range(3):
        x, y, z = stage[i, 0], stage[i, 1], stage[i, 2]
        psi += h * _B[i] * (Ia * x * x + Ib * y * y + Ic * z * z + L * sign * x) / (L + sign * Ia * x)
    x, y, z = h * _B[0], h * _B[1], h * _B[2]
    w[a] = wa + (x * slope[0, 0] + y * slope[1, 0] + z * slope[2, 0])
    w[b] = wb + (x * slope[0, 1] + y * slope[1, 1] + z * slope[2, 1])
    w[c] = wc + (x * slope[0, 2] + y * slope[1, 2] + z * slope[2, 2])
    Ma, Mb, Mc = Ia * w[a], Ib * w[b], Ic * w[c]
    M = math.sqrt(Ma * Ma + Mb * Mb + Mc * Mc)
    # Q(L) = (±L x a, |L| ± L_a) up to its length; p = Q(L)ᵀ R_a(±psi), and e = p Q(M), of length 2 to 4.
    l, m, size = L + sign * La, M + sign * Ma, 1.0 / (L * M)
    s, t = size * math.sin(0.5 * psi), size * math.cos(0.5 * psi)
    pa, pb, pc, p = sign * l * s, Lb * s - sign * Lc * t, Lc * s + sign * Lb * t, l * t
    mb, mc = sign * Mc, -sign * Mb
    e[a], e[b], e[c] = m * pa + pb * mc - pc * mb, m * pb + p * mb - pa * mc, m * pc + p * mc + pa * mb
    e[3] = m * p - pb * mb - pc * mc


@kernel
def flow(moments, axes, x, quaternion, v, h, x_out, quaternion_out, v_out):
    """Motion of free bodies over h without forces, into the outputs, which may be the inputs.

    Positions move along straight lines. Attitudes and spins are those of bodies without torque, whose energy and
    angular momentum in space are kept to round-off. A body at rest stays unchanged. A steady spin, of a body with equal
    moments or about a principal axis, is R exp([h omega]x).

    Parameters
    ----------
    moments, axes : ndarray, shapes (n, 3) and (n, 3, 3)
        Inertias, see `principal`.
    x, quaternion : ndarray, shapes (n, 3) and (n, 4)
        Centres of mass and unit quaternions xyzw, body to world.
    v : ndarray, shape (nv,)
        Velocities, nv >= 6 n: linear in the world, angular in body axes. Entries after those of free bodies are left
        unchanged.
    h : float
        Duration, not negative, s.
    """
    w, e, stage, slope = np.empty(3), np.empty(4), np.empty((3, 3)), np.empty((3, 3))
    for b in range(x.shape[0]):
        o = 6 * b
        spin, q = three(v, o + 3), four(quaternion, b)
        put(x_out, b, along(row(x, b), h, three(v, o)))
        for i in range(4):
            quaternion_out[b, i] = q[i]
        for i in range(o, o + 6):
            v_out[i] = v[i]
        if spin == (0.0, 0.0, 0.0):
            continue
        I, square = moments[b], dot(spin, spin)
        w[0], w[1], w[2] = to_local(axes, b, spin)
        gyroscopic = max(
            abs((I[1] - I[2]) * w[1] * w[2]), abs((I[2] - I[0]) * w[2] * w[0]), abs((I[0] - I[1]) * w[0] * w[1])
        )
        # The spin is steady to round-off, or too slow to turn the body in h.
        if gyroscopic <= 2.0 * _EPS * square * min(I[0], I[1], I[2]) or h * h * square < 1e-40:
            half = 0.5 * h * math.sqrt(square)
            if half > 0.0:
                q = _times(q, times(0.5 * h * math.sin(half) / half, spin), math.cos(half))
        else:
            left = h
            for _ in range(PARTS):
                parts = max(1.0, np.ceil(left * math.sqrt(dot(w, w)) / PART))
                part = left / parts
                _collocate(I, w, part, stage, slope, e)
                q = _times(q, to_world(axes, b, three(e, 0)), e[3])
                if parts == 1.0:
                    break
                left -= part
            # Only the change is transformed back through the axes, whose round-off would otherwise add up.
            change = to_world(axes, b, minus(w, to_local(axes, b, spin)))
            v_out[o + 3], v_out[o + 4], v_out[o + 5] = along(spin, 1.0, change)
        for i in range(4):
            quaternion_out[b, i] = q[i]
