"""Motion of free bodies, the rows of their contact Jacobian, and surfaces that move as prescribed.

A free body b has the velocity (linear in the world frame, angular in body axes) at v[6 b : 6 b + 6], which makes its
mass matrix diag(m I, J) constant.
"""

import math

import numpy as np

from nsdyn._kernels.compiled import in_place, kernel
from nsdyn._kernels.dynamics import rotation
from nsdyn._kernels.reductions import copy
from nsdyn._kernels.vectors import square


@in_place
def integrate(x, quaternion, v, h, x_out, quaternion_out):
    """Positions x + h v and rotations R exp([h omega]x), unit quaternions xyzw, into the outputs (n, 3) and (n, 4)."""
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


@in_place
def rotations(quaternion, R):
    """Rotation matrices of unit quaternions xyzw, into R (n, 3, 3)."""
    for b in range(quaternion.shape[0]):
        x, y, z, w = quaternion[b, 0], quaternion[b, 1], quaternion[b, 2], quaternion[b, 3]
        R[b, 0, 0], R[b, 0, 1], R[b, 0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)
        R[b, 1, 0], R[b, 1, 1], R[b, 1, 2] = 2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)
        R[b, 2, 0], R[b, 2, 1], R[b, 2, 2] = 2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)


@in_place
def place(x, quaternion, x_out, R):
    """Positions into x_out and `rotations` into R, which may have room for more."""
    for b in range(x.shape[0]):
        for i in range(3):
            x_out[b, i] = x[b, i]
    rotations(quaternion, R)


@in_place
def flow(moments, axes, x, quaternion, v, h, x_out, quaternion_out, v_out, x_frames, R):
    """`rotation.flow` of free bodies, and `place` where it ends.

    Parameters
    ----------
    moments, axes, x, quaternion, v, h, x_out, quaternion_out, v_out
        As of `rotation.flow`.
    x_frames, R : ndarray, shapes (frames, 3), (frames, 3, 3)
        Poses of the frames, written.
    """
    rotation.flow(moments, axes, x, quaternion, v, h, x_out, quaternion_out, v_out)
    place(x_out, quaternion_out, x_frames, R)


@kernel
def keep_spin(J, inverse_J, quaternion, turned, v, out):
    """Angular velocities in body axes that have the same angular momentum in space after a turn, into out (n,).

    w' = J⁻¹ R'ᵀ R J w, of bodies that were turned from quaternion to turned; all else is that of v.
    """
    R, S = np.empty((J.shape[0], 3, 3)), np.empty((J.shape[0], 3, 3))
    rotations(quaternion, R)
    rotations(turned, S)
    copy(v, out)
    spin, space = np.empty(3), np.empty(3)
    for b in range(J.shape[0]):
        f = 6 * b + 3
        if v[f] == 0.0 and v[f + 1] == 0.0 and v[f + 2] == 0.0:
            continue
        for i in range(3):
            spin[i] = J[b, i, 0] * v[f] + J[b, i, 1] * v[f + 1] + J[b, i, 2] * v[f + 2]
        for i in range(3):
            space[i] = R[b, i, 0] * spin[0] + R[b, i, 1] * spin[1] + R[b, i, 2] * spin[2]
        for i in range(3):
            spin[i] = S[b, 0, i] * space[0] + S[b, 1, i] * space[1] + S[b, 2, i] * space[2]
        for i in range(3):
            out[f + i] = inverse_J[b, i, 0] * spin[0] + inverse_J[b, i, 1] * spin[1] + inverse_J[b, i, 2] * spin[2]


@in_place
def accelerate(inverse_mass, inverse_J, gravity, force, torque, h, v, out):
    """v + h M⁻¹ f of free bodies under gravity, forces (world axes) and torques (body axes), into out."""
    for b in range(inverse_mass.size):
        for i in range(3):
            out[6 * b + i] = v[6 * b + i] + h * (gravity[i] + inverse_mass[b] * force[b, i])
            spin = 0.0
            for j in range(3):
                spin += inverse_J[b, i, j] * torque[b, j]
            out[6 * b + 3 + i] = v[6 * b + 3 + i] + h * spin


@in_place
def twists(R, v, free, linear, angular):
    """Velocities of the centres of mass and angular velocities of free bodies in world axes, into (n, 3) each."""
    for b in range(free):
        for i in range(3):
            linear[b, i] = v[6 * b + i]
            angular[b, i] = R[b, i, 0] * v[6 * b + 3] + R[b, i, 1] * v[6 * b + 4] + R[b, i, 2] * v[6 * b + 5]


@in_place
def reach(v, h, fall, radius, out):
    """How far any point of each free body moves in h seconds, and by `fall`, m, into out (n,)."""
    for b in range(radius.size):
        i = 6 * b
        speed = math.sqrt(square(v[i]) + square(v[i + 1]) + square(v[i + 2]))
        spin = math.sqrt(square(v[i + 3]) + square(v[i + 4]) + square(v[i + 5]))
        out[b] = h * (speed + spin * radius[b]) + fall


@in_place
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


@in_place
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


@in_place
def free_rows(frame1, frame2, point, frame, x, R, free, start, H):
    """Rows of Hᵀ on free bodies: direction d gives (d, Rᵀ ((p - x) x d)), minus on body 1, into H.

    Parameters
    ----------
    frame1, frame2 : ndarray of int, shape (nc,)
        Of each contact; those from `free` on and below 0 are no free bodies.
    point, frame : ndarray, shapes (nc, 3), (nc, 3, 3)
        World; rows (n, t1, t2).
    x, R : ndarray, shapes (free, 3), (free, 3, 3)
        Of the bodies.
    free : int
    start : ndarray of int, shape (nc, 2)
        Where the rows of each contact and side begin in H.
    H : ndarray
    """
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
                H[row], H[row + 1], H[row + 2] = d0, d1, d2
                for j in range(3):
                    H[row + 3 + j] = R[b, 0, j] * m0 + R[b, 1, j] * m1 + R[b, 2, j] * m2


@in_place
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


@kernel
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


@in_place
def free_works(mass, gravity, force, torque, h, theta, v, v0, v1):
    """Works of a step on the free bodies, J: of forces and torques, and what gravity does beyond its potential.

    They work on the mean of v0 and v1; the bodies move by (1 - θ) h v + θ h v1. Both are the same for θ = ½ but where
    impacts turned v to v0.

    Parameters
    ----------
    mass : ndarray, shape (free,)
    gravity : ndarray, shape (3,)
    force, torque : ndarray, shape (free, 3)
        World axes, N and N m; the torques in those of the bodies.
    h, theta : float
    v, v0, v1 : ndarray, shape (n,)
        At the beginning of the step, and before and after the forces where they act.
    """
    external, beyond = 0.0, 0.0
    for b in range(mass.size):
        i = 6 * b
        for j in range(3):
            mean, spin = 0.5 * (v0[i + j] + v1[i + j]), 0.5 * (v0[i + 3 + j] + v1[i + 3 + j])
            external += h * (mean * force[b, j] + spin * torque[b, j])
            beyond += h * mass[b] * gravity[j] * (mean - ((1.0 - theta) * v[i + j] + theta * v1[i + j]))
    return external, beyond


@in_place
def surface_velocities(geom, motion_of_geom, origin, linear, angular, slides, point, normal, sign, w):
    """Add the velocity of prescribed bodies at the contacts, times sign, to w (nc, 3), world axes.

    Motion m has the velocity linear[m] + angular[m] x (p - origin[m]); where it slides in itself (a conveyor), only
    the tangential part counts.

    Parameters
    ----------
    geom : ndarray of int, shape (nc,)
        Of each contact, on one side.
    motion_of_geom : ndarray of int, shape (geoms,)
        -1 where nothing is prescribed.
    origin, linear, angular : ndarray, shape (motions, 3)
        m, m/s, rad/s.
    slides : ndarray of bool, shape (motions,)
    point, normal : ndarray, shape (nc, 3)
    sign : float
    w : ndarray, shape (nc, 3)
    """
    for c in range(geom.size):
        m = motion_of_geom[geom[c]]
        if m < 0:
            continue
        p0, p1, p2 = point[c, 0] - origin[m, 0], point[c, 1] - origin[m, 1], point[c, 2] - origin[m, 2]
        a = angular[m]
        v0 = linear[m, 0] + a[1] * p2 - a[2] * p1
        v1 = linear[m, 1] + a[2] * p0 - a[0] * p2
        v2 = linear[m, 2] + a[0] * p1 - a[1] * p0
        out = normal[c, 0] * v0 + normal[c, 1] * v1 + normal[c, 2] * v2 if slides[m] else 0.0
        w[c, 0] += sign * (v0 - out * normal[c, 0])
        w[c, 1] += sign * (v1 - out * normal[c, 1])
        w[c, 2] += sign * (v2 - out * normal[c, 2])
