"""Motion of free bodies, the rows of their contact Jacobian, and velocities of moving surfaces.

A free body b has the velocity (linear in the world frame, angular in body axes) at v[6 b : 6 b + 6]. Its mass matrix
diag(m I, J) is therefore constant.
"""

import math

import numpy as np

from nsdyn._kernels.compiled import kernel, no_alloc
from nsdyn._kernels.reductions import copy
from nsdyn._kernels.vectors import along, cross, dot, four, minus, put, row, three, times, to_local, to_world, turned


@no_alloc
def integrate(x, quaternion, step, x_out, quaternion_out):
    """Positions x + dx and rotations R exp([w]x), step = (dx, w) per body, into the outputs (n, 3) and (n, 4)."""
    for b in range(x.shape[0]):
        put(x_out, b, along(row(x, b), 1.0, three(step, 6 * b)))
        a, q, size = times(0.5, three(step, 6 * b + 3)), four(quaternion, b), 1.0
        half = math.sqrt(dot(a, a))
        if half != 0.0:
            e0, e1, e2 = times(math.sin(half) / half, a)
            q, size = turned(q, (e0, e1, e2, math.cos(half)))
        for i in range(4):
            quaternion_out[b, i] = q[i] / size


@no_alloc
def rotations(quaternion, R):
    """Write the rotation matrices of unit quaternions xyzw into R (n, 3, 3)."""
    for b in range(quaternion.shape[0]):
        x, y, z, w = quaternion[b, 0], quaternion[b, 1], quaternion[b, 2], quaternion[b, 3]
        R[b, 0, 0], R[b, 0, 1], R[b, 0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)
        R[b, 1, 0], R[b, 1, 1], R[b, 1, 2] = 2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)
        R[b, 2, 0], R[b, 2, 1], R[b, 2, 2] = 2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)


@no_alloc
def place(x, quaternion, x_out, R):
    """Write positions into x_out and `rotations` into R; both may have room for more."""
    for b in range(x.shape[0]):
        put(x_out, b, row(x, b))
    rotations(quaternion, R)


@kernel
def keep_spin(J, inverse_J, quaternion, turned, v, out):
    """Angular velocities in body axes with the same angular momentum in space after a rotation, into out (n,).

    w' = J⁻¹ R'ᵀ R J w, for bodies that were rotated from `quaternion` to `turned`; all other entries are those of v.
    """
    R, S = np.empty((J.shape[0], 3, 3)), np.empty((J.shape[0], 3, 3))
    rotations(quaternion, R)
    rotations(turned, S)
    copy(v, out)
    for b in range(J.shape[0]):
        f = 6 * b + 3
        spin = three(v, f)
        if spin != (0.0, 0.0, 0.0):
            momentum = to_local(S, b, to_world(R, b, to_world(J, b, spin)))
            out[f], out[f + 1], out[f + 2] = to_world(inverse_J, b, momentum)


@no_alloc
def accelerate(inverse_mass, inverse_J, gravity, force, torque, h, v, out):
    """v + h M⁻¹ f of free bodies under gravity, forces (world axes) and torques (body axes), into out."""
    for b in range(inverse_mass.size):
        i, push, turn = 6 * b, along(gravity, inverse_mass[b], row(force, b)), to_world(inverse_J, b, row(torque, b))
        out[i], out[i + 1], out[i + 2] = along(three(v, i), h, push)
        out[i + 3], out[i + 4], out[i + 5] = along(three(v, i + 3), h, turn)


@no_alloc
def twists(R, v, free, linear, angular):
    """Velocities of the centres of mass and angular velocities of free bodies in world axes, into (n, 3) each."""
    for b in range(free):
        put(linear, b, three(v, 6 * b))
        put(angular, b, to_world(R, b, three(v, 6 * b + 3)))


@no_alloc
def reach(v, h, fall, radius, out):
    """Bound on the way of any point of each free body in h s, plus `fall`, m, into out (n,)."""
    for b in range(radius.size):
        speed, spin = three(v, 6 * b), three(v, 6 * b + 3)
        out[b] = h * (math.sqrt(dot(speed, speed)) + math.sqrt(dot(spin, spin)) * radius[b]) + fall


@no_alloc
def contact_frames(normal, frame):
    """Write contact frames with rows (n, t1, t2) into frame (nc, 3, 3).

    Tangents vary continuously with n except at n = -e_z (T. Duff et al., Building an orthonormal basis, revisited, JCGT
    6, 2017).
    """
    for c in range(normal.shape[0]):
        x, y, z = normal[c, 0], normal[c, 1], normal[c, 2]
        sign = math.copysign(1.0, z)
        a = -1.0 / (sign + z)
        b = x * y * a
        frame[c, 0, 0], frame[c, 0, 1], frame[c, 0, 2] = x, y, z
        frame[c, 1, 0], frame[c, 1, 1], frame[c, 1, 2] = 1.0 + sign * x * x * a, sign * b, -sign * x
        frame[c, 2, 0], frame[c, 2, 1], frame[c, 2, 2] = b, sign + y * y * a, -y


@no_alloc
def contact_layout(contacts, node, offset, frame, block, start):
    """Write `contact_frames`, the blocks of every contact (side 0: minus, side 1: plus), and the starts of their rows.

    Two links of one tree share its block and are merged into side 0. Returns the size of H. Contacts are those of
    `nsdyn.collision.contacts.ContactSet`, (names, points, scalars), and `node` is that of `Layout`.
    """
    names, points, _ = contacts
    contact_frames(points[1], frame)
    size = 0
    for c in range(names.shape[1]):
        a, b = node[names[2, c]], node[names[3, c]]
        block[c, 0], block[c, 1] = a, (-1 if a == b else b)
        for s in range(2):
            start[c, s] = size
            if block[c, s] >= 0:
                size += 3 * (offset[block[c, s] + 1] - offset[block[c, s]])
    return size


@no_alloc
def free_rows(contacts, frame, x, R, free, start, H):
    """Rows of Hᵀ on free bodies: direction d gives (d, Rᵀ ((p - x) x d)), minus on body 1, into H.

    Parameters
    ----------
    contacts : (names, points, scalars)
        Frames below 0, and from `free` on, are not those of free bodies.
    frame : ndarray, shape (nc, 3, 3)
        World; rows (n, t1, t2).
    x, R : ndarray, shapes (free, 3), (free, 3, 3)
        Poses of the bodies.
    free : int
    start : ndarray of int, shape (nc, 2)
        Index in H where the rows of each contact and side begin.
    H : ndarray
    """
    names, points, _ = contacts
    for c in range(names.shape[1]):
        for s in range(2):
            b = names[2 + s, c]
            if b < 0 or b >= free:
                continue
            arm = minus(row(points[0], c), row(x, b))
            for i in range(3):
                d, at = times(-1.0 if s == 0 else 1.0, row(frame[c], i)), start[c, s] + 6 * i
                H[at], H[at + 1], H[at + 2] = d
                H[at + 3], H[at + 4], H[at + 5] = to_local(R, b, cross(arm, d))


@no_alloc
def free_energies(mass, J, gravity, x, v):
    """(kinetic, potential) energy of the free bodies, in J."""
    kinetic, potential = 0.0, 0.0
    for b in range(mass.size):
        i = 6 * b
        kinetic += 0.5 * mass[b] * dot(three(v, i), three(v, i))
        for j in range(3):
            for k in range(3):
                kinetic += 0.5 * v[i + 3 + j] * J[b, j, k] * v[i + 3 + k]
        potential -= mass[b] * dot(gravity, row(x, b))
    return kinetic, potential


@kernel
def pinocchio_layout(x, quaternion, v, q_out, v_out):
    """Free bodies in Pinocchio's layout: q = (x, quaternion), v = (Rᵀ v, omega), into q_out; all of v into v_out."""
    R = np.empty((x.shape[0], 3, 3))
    rotations(quaternion, R)
    copy(v, v_out)
    for b in range(x.shape[0]):
        i = 6 * b
        v_out[i], v_out[i + 1], v_out[i + 2] = to_local(R, b, three(v, i))
        copy(x[b], q_out[7 * b :])
        copy(quaternion[b], q_out[7 * b + 3 :])


@no_alloc
def beyond_potential(mass, gravity, h, theta, v, v0, v1):
    """Work of gravity on the free bodies in a step minus the decrease of its potential, J.

    Gravity works on the mean of v0 and v1; the bodies move by (1 - θ) h v + θ h v1. For θ = ½ both are the same, except
    if impacts changed v to v0.

    Parameters
    ----------
    mass : ndarray, shape (free,)
    gravity : ndarray, shape (3,)
    h, theta : float
    v, v0, v1 : ndarray, shape (n,)
        Velocity at the beginning of the step, and before and after the forces at the midpoint.
    """
    out = 0.0
    for b in range(mass.size):
        i = 6 * b
        for j in range(3):
            mean = 0.5 * (v0[i + j] + v1[i + j])
            out += h * mass[b] * gravity[j] * (mean - ((1.0 - theta) * v[i + j] + theta * v1[i + j]))
    return out


@no_alloc
def surface_velocities(contacts, surfaces, w):
    """Add the velocity of moving surfaces at the contacts, geom 2 minus geom 1, to w (nc, 3), world axes.

    Motion m has the velocity linear[m] + angular[m] x (p - origin[m]). If it `slides` in itself (a conveyor), only the
    tangential part counts. `contacts` is (names, points, scalars). `surfaces` is (motion of every geom, -1 for geoms
    without one, origin, linear, angular, slides).
    """
    (names, points, _), (motion_of_geom, origin, linear, angular, slides) = contacts, surfaces
    for c in range(names.shape[1]):
        for s in range(2):
            m = motion_of_geom[names[s, c]]
            if m < 0:
                continue
            p, n, l, a = minus(row(points[0], c), row(origin, m)), row(points[1], c), linear[m], angular[m]
            v = l[0] + a[1] * p[2] - a[2] * p[1], l[1] + a[2] * p[0] - a[0] * p[2], l[2] + a[0] * p[1] - a[1] * p[0]
            if slides[m]:
                v = along(v, -dot(n, v), n)
            put(w, c, along(row(w, c), -1.0 if s == 0 else 1.0, v))
