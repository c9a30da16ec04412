"""Motion of free bodies and the rows of their contact Jacobian.

A free body b has the velocity (linear in the world frame, angular in body axes) at v[6 b : 6 b + 6], which makes its
mass matrix diag(m I, J) constant.
"""

import math

import numpy as np
from numba import njit


@njit(cache=True)
def integrate(x, quaternion, v, h, x_out, quaternion_out):
    """X + h v and R exp([h omega]x), on unit quaternions xyzw, into the outputs (n, 3) and (n, 4)."""
    for b in range(x.shape[0]):
        for i in range(3):
            x_out[b, i] = x[b, i] + h * v[6 * b + i]
        a0, a1, a2 = 0.5 * h * v[6 * b + 3], 0.5 * h * v[6 * b + 4], 0.5 * h * v[6 * b + 5]
        half = math.sqrt(a0 * a0 + a1 * a1 + a2 * a2)
        q0, q1, q2, q3 = quaternion[b, 0], quaternion[b, 1], quaternion[b, 2], quaternion[b, 3]
        if half == 0.0:
            quaternion_out[b, 0], quaternion_out[b, 1] = q0, q1
            quaternion_out[b, 2], quaternion_out[b, 3] = q2, q3
            continue
        s, c = math.sin(half) / half, math.cos(half)
        e0, e1, e2 = s * a0, s * a1, s * a2
        p0 = q3 * e0 + q0 * c + q1 * e2 - q2 * e1
        p1 = q3 * e1 - q0 * e2 + q1 * c + q2 * e0
        p2 = q3 * e2 + q0 * e1 - q1 * e0 + q2 * c
        p3 = q3 * c - q0 * e0 - q1 * e1 - q2 * e2
        norm = math.sqrt(p0 * p0 + p1 * p1 + p2 * p2 + p3 * p3)
        quaternion_out[b, 0], quaternion_out[b, 1] = p0 / norm, p1 / norm
        quaternion_out[b, 2], quaternion_out[b, 3] = p2 / norm, p3 / norm


@njit(cache=True)
def rotations(quaternion, R):
    """Rotation matrices of unit quaternions xyzw, into R (n, 3, 3)."""
    for b in range(quaternion.shape[0]):
        x, y, z, w = quaternion[b, 0], quaternion[b, 1], quaternion[b, 2], quaternion[b, 3]
        R[b, 0, 0], R[b, 0, 1], R[b, 0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)
        R[b, 1, 0], R[b, 1, 1], R[b, 1, 2] = 2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)
        R[b, 2, 0], R[b, 2, 1], R[b, 2, 2] = 2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)


@njit(cache=True)
def place(x, quaternion, x_out, R):
    """Positions into x_out and `rotations` into R, which may have room for more."""
    for b in range(x.shape[0]):
        for i in range(3):
            x_out[b, i] = x[b, i]
    rotations(quaternion, R)


@njit(cache=True)
def _solve3(A, b, x):
    """x = A⁻¹ b by Cramer's rule."""
    c0 = A[1, 1] * A[2, 2] - A[1, 2] * A[2, 1]
    c1 = A[1, 2] * A[2, 0] - A[1, 0] * A[2, 2]
    c2 = A[1, 0] * A[2, 1] - A[1, 1] * A[2, 0]
    det = A[0, 0] * c0 + A[0, 1] * c1 + A[0, 2] * c2
    x[0] = (
        b[0] * c0 + b[1] * (A[0, 2] * A[2, 1] - A[0, 1] * A[2, 2]) + b[2] * (A[0, 1] * A[1, 2] - A[0, 2] * A[1, 1])
    ) / det
    x[1] = (
        b[0] * c1 + b[1] * (A[0, 0] * A[2, 2] - A[0, 2] * A[2, 0]) + b[2] * (A[0, 2] * A[1, 0] - A[0, 0] * A[1, 2])
    ) / det
    x[2] = (
        b[0] * c2 + b[1] * (A[0, 1] * A[2, 0] - A[0, 0] * A[2, 1]) + b[2] * (A[0, 0] * A[1, 1] - A[0, 1] * A[1, 0])
    ) / det


RESOLVED = 2.0
"""Radians per step up to which the gyroscopic term belongs to the rotation vector that turns the body. Beyond, tan of
half the angle no longer says how far the body turns."""

PARTS = 1024
"""Most parts in which a step may be cut for a rotation that Newton cannot follow at once."""


@njit(cache=True)
def _lengthening(half):
    """Factor κ = tan(y)/y that makes a Cayley map turn by its vector's length, y half of it, and dκ/dy."""
    if half < 1e-3:
        return 1.0 + half * half / 3.0, 2.0 * half / 3.0
    if half > 0.5 * RESOLVED:
        return math.tan(0.5 * RESOLVED) / (0.5 * RESOLVED), 0.0
    t = math.tan(half)
    return t / half, ((1.0 + t * t) * half - t) / (half * half)


@njit(cache=True)
def _turn(I, w, h, torque, kick, new, gyroscopic):
    """Spin at the end of a step with the change `kick` by contacts, into new; adds the gyroscopic torque of the step.

        J (w' - w) = J kick + h (torque + γ),   γ = -κ w* x (J w* + h torque/2),   w* = (w + w')/2.

    Without kick this is J w' = exp(-[h w*]x) (J w + h torque) where exp is written as a Cayley map, so that with
    R' = R exp([h w*]x) the change of R J w is h R torque exactly, and that of the energy h w*·torque. Newton from new.
    Returns whether it converged; `gyroscopic` is left alone if not.
    """
    A, mid, z, rhs, dw, g = np.empty((3, 3)), np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    last = np.inf
    for _ in range(50):
        for i in range(3):
            mid[i] = 0.5 * (w[i] + new[i])
        rate = math.sqrt(mid[0] * mid[0] + mid[1] * mid[1] + mid[2] * mid[2])
        kappa, slope = _lengthening(0.5 * h * rate)
        for i in range(3):
            z[i] = I[i, 0] * mid[0] + I[i, 1] * mid[1] + I[i, 2] * mid[2] + 0.5 * h * torque[i]
        g[0] = -(mid[1] * z[2] - mid[2] * z[1])
        g[1] = -(mid[2] * z[0] - mid[0] * z[2])
        g[2] = -(mid[0] * z[1] - mid[1] * z[0])
        k = 0.5 * h * kappa
        stretch = 0.25 * h * h * slope / rate if rate > 0.0 else 0.0
        for i in range(3):
            rhs[i] = h * (torque[i] + kappa * g[i])
            for j in range(3):
                rhs[i] -= I[i, j] * (new[j] - w[j] - kick[j])
                # d(mid x z)/d new = ([mid]x J - [z]x) / 2, and what κ changes
                A[i, j] = I[i, j] - stretch * g[i] * mid[j]
        for j in range(3):
            A[0, j] += k * (mid[1] * I[2, j] - mid[2] * I[1, j])
            A[1, j] += k * (mid[2] * I[0, j] - mid[0] * I[2, j])
            A[2, j] += k * (mid[0] * I[1, j] - mid[1] * I[0, j])
        A[0, 1] += k * z[2]
        A[0, 2] -= k * z[1]
        A[1, 0] -= k * z[2]
        A[1, 2] += k * z[0]
        A[2, 0] += k * z[1]
        A[2, 1] -= k * z[0]
        _solve3(A, rhs, dw)
        change = max(abs(dw[0]), abs(dw[1]), abs(dw[2]))
        for i in range(3):
            new[i] += dw[i]
        # Newton has converged when round-off stops the correction from shrinking.
        if change == 0.0 or (change >= last and change <= 1e-12 * (abs(new[0]) + abs(new[1]) + abs(new[2]))):
            for i in range(3):
                gyroscopic[i] += kappa * g[i]
            return True
        last = change
    return False


@njit(cache=True)
def flow(J, x, quaternion, v, h, x_out, quaternion_out, v_out):
    """placeholder"""
    v_out[:] = v
    w, new, zero, g = np.empty(3), np.empty(3), np.zeros(3), np.empty(3)
    mid = v.copy()
    for b in range(J.shape[0]):
        f = 6 * b + 3
        if v[f] == 0.0 and v[f+1] == 0.0 and v[f+2] == 0.0:
            continue
        for i in range(3):
            w[i] = new[i] = v[f + i]
        g[:] = 0.0
        _turn(J[b], w, h, zero, zero, new, g)
        for i in range(3):
            v_out[f + i] = new[i]
            mid[f + i] = 0.5 * (w[i] + new[i])
    integrate(x, quaternion, mid, h, x_out, quaternion_out)


@njit(cache=True)
def accelerate(inverse_mass, inverse_J, gravity, force, torque, h, v, out):
    """v + h M⁻¹ f of free bodies under gravity, forces (world axes) and torques (body axes), into out."""
    for b in range(inverse_mass.size):
        for i in range(3):
            out[6 * b + i] = v[6 * b + i] + h * (gravity[i] + inverse_mass[b] * force[b, i])
            spin = 0.0
            for j in range(3):
                spin += inverse_J[b, i, j] * torque[b, j]
            out[6 * b + 3 + i] = v[6 * b + 3 + i] + h * spin


@njit(cache=True)
def twists(R, v, free, linear, angular):
    """Velocities of the centres of mass and angular velocities of free bodies in world axes, into (n, 3) each."""
    for b in range(free):
        for i in range(3):
            linear[b, i] = v[6 * b + i]
            angular[b, i] = R[b, i, 0] * v[6 * b + 3] + R[b, i, 1] * v[6 * b + 4] + R[b, i, 2] * v[6 * b + 5]


@njit(cache=True)
def reach(v, h, fall, radius, out):
    """How far any point of each free body moves in h seconds, and by `fall`, m, into out (n,)."""
    for b in range(radius.size):
        i = 6 * b
        speed = math.sqrt(v[i] ** 2 + v[i + 1] ** 2 + v[i + 2] ** 2)
        spin = math.sqrt(v[i + 3] ** 2 + v[i + 4] ** 2 + v[i + 5] ** 2)
        out[b] = h * (speed + spin * radius[b]) + fall


@njit(cache=True)
def contact_frames(normal, frame):
    """Contact frames with rows (n, t1, t2), into frame (nc, 3, 3).

    Tangents vary continuously with n except at n = -e_z (T. Duff et al., Building an orthonormal basis, revisited,
    JCGT 6, 2017).
    """
    for c in range(normal.shape[0]):
        x, y, z = normal[c, 0], normal[c, 1], normal[c, 2]
        sign = math.copysign(1.0, z)
        a = -1.0 / (sign + z)
        b = x * y * a
        frame[c, 0, 0], frame[c, 0, 1], frame[c, 0, 2] = x, y, z
        frame[c, 1, 0], frame[c, 1, 1], frame[c, 1, 2] = 1.0 + sign * x * x * a, sign * b, -sign * x
        frame[c, 2, 0], frame[c, 2, 1], frame[c, 2, 2] = b, sign + y * y * a, -y


@njit(cache=True)
def contact_layout(normal, frame1, frame2, block_of_frame, offset, frame, block, start):
    """`contact_frames`, blocks of every contact (side 0: minus, side 1: plus) and where their rows begin.

    Two links of one tree share its block and are merged into side 0. Returns the size of h.
    """
    contact_frames(normal, frame)
    size = 0
    for c in range(frame1.size):
        a = block_of_frame[frame1[c]] if frame1[c] >= 0 else -1
        b = block_of_frame[frame2[c]] if frame2[c] >= 0 else -1
        block[c, 0], block[c, 1] = a, (-1 if a == b else b)
        for s in range(2):
            start[c, s] = size
            if block[c, s] >= 0:
                size += 3 * (offset[block[c, s] + 1] - offset[block[c, s]])
    return size


@njit(cache=True)
def free_rows(frame1, frame2, point, frame, x, R, free, start, h):
    """Rows of Hᵀ on free bodies: direction d gives (d, Rᵀ ((p - x) x d)), minus on body 1, into h."""
    for c in range(frame1.size):
        for s in range(2):
            b = frame1[c] if s == 0 else frame2[c]
            if b < 0 or b >= free:
                continue
            sign = -1.0 if s == 0 else 1.0
            p0, p1, p2 = point[c, 0] - x[b, 0], point[c, 1] - x[b, 1], point[c, 2] - x[b, 2]
            for i in range(3):
                d0, d1, d2 = sign * frame[c, i, 0], sign * frame[c, i, 1], sign * frame[c, i, 2]
                m0, m1, m2 = p1 * d2 - p2 * d1, p2 * d0 - p0 * d2, p0 * d1 - p1 * d0
                row = start[c, s] + 6 * i
                h[row], h[row + 1], h[row + 2] = d0, d1, d2
                for j in range(3):
                    h[row + 3 + j] = R[b, 0, j] * m0 + R[b, 1, j] * m1 + R[b, 2, j] * m2


@njit(cache=True)
def free_energies(mass, J, gravity, x, v):
    """(kinetic, potential) energy of the free bodies, in J."""
    kinetic, potential = 0.0, 0.0
    for b in range(mass.size):
        i = 6 * b
        kinetic += 0.5 * mass[b] * (v[i] * v[i] + v[i + 1] * v[i + 1] + v[i + 2] * v[i + 2])
        for j in range(3):
            for k in range(3):
                kinetic += 0.5 * v[i + 3 + j] * J[b, j, k] * v[i + 3 + k]
        potential -= mass[b] * (gravity[0] * x[b, 0] + gravity[1] * x[b, 1] + gravity[2] * x[b, 2])
    return kinetic, potential


@njit(cache=True)
def pinocchio_layout(x, quaternion, v, q_out, v_out):
    """Free bodies in Pinocchio's layout: q = (x, quaternion), v = (Rᵀ v, omega), into q_out; all of v into v_out."""
    R = np.empty((x.shape[0], 3, 3))
    rotations(quaternion, R)
    for i in range(6 * x.shape[0], v.size):
        v_out[i] = v[i]
    for b in range(x.shape[0]):
        for i in range(3):
            q_out[7 * b + i] = x[b, i]
            v_out[6 * b + i] = R[b, 0, i] * v[6 * b] + R[b, 1, i] * v[6 * b + 1] + R[b, 2, i] * v[6 * b + 2]
            v_out[6 * b + 3 + i] = v[6 * b + 3 + i]
        for i in range(4):
            q_out[7 * b + 3 + i] = quaternion[b, i]


@njit(cache=True)
def free_works(mass, gravity, force, torque, h, theta, v, v0, v1):
    """Works of a step on the free bodies, J: of forces and torques, and what gravity does beyond its potential.

    v0 and v1 are the velocities before and after them where they act, which do their work on the mean; the bodies move
    by (1 - θ) h v + θ h v1. Both are the same for θ = ½ but where impacts turned v to v0.
    """
    external, beyond = 0.0, 0.0
    for b in range(mass.size):
        i = 6 * b
        for j in range(3):
            mean, spin = 0.5 * (v0[i + j] + v1[i + j]), 0.5 * (v0[i + 3 + j] + v1[i + 3 + j])
            external += h * (mean * force[b, j] + spin * torque[b, j])
            beyond += h * mass[b] * gravity[j] * (mean - ((1.0 - theta) * v[i + j] + theta * v1[i + j]))
    return external, beyond
