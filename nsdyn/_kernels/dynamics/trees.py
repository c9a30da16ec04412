"""Articulated trees: free motion, rows of contacts on links, rows of joint limits and joint friction.

Joint rows follow the contacts of a step, three each like them. A limit is a frictionless contact with one normal row
±e_j; dry friction |tau| <= tau_c is a contact with mu = 1 whose first tangent row is e_j and whose normal row lies on
a coordinate of its own, pressed so that r_N = h tau_c exactly. Rows that are not named are zero.
"""

import math

import numpy as np

from nsdyn._kernels.compiled import kernel


@kernel
def implicit(M, damping, stiffness, kp, kd, tau, stretch, v, h, theta, F, m, minv, force):
    """The forces linear in the velocity v' after the forces: the effective mass matrix, its inverse, and what is left.

    m = M + h (theta D + h theta² K + kd + h kp) and minv = Fᵀ F, where F = L⁻¹ for its Cholesky factor L, all (n, n);
    force (n,) is what `forces` gives for v' = v. False when m is not positive definite.
    """
    n = M.shape[0]
    for i in range(n):
        for j in range(n):
            m[i, j] = minv[i, j] = M[i, j]
        minv[i, i] = m[i, i] = m[i, i] + h * (theta * damping[i] + h * theta * theta * stiffness[i] + kd[i] + h * kp[i])
    # All loops end along rows, which the compiler makes vectors of. Here minv becomes Lᵀ, in its upper half.
    for k in range(n):
        if not minv[k, k] > 0.0:
            return False
        minv[k, k] = math.sqrt(minv[k, k])
        for j in range(k + 1, n):
            minv[k, j] /= minv[k, k]
        for i in range(k + 1, n):
            x = minv[k, i]
            for j in range(i, n):
                minv[i, j] -= x * minv[k, j]
    F[:] = 0.0
    for i in range(n):
        for k in range(i):
            x = minv[k, i]
            for j in range(k + 1):
                F[i, j] -= x * F[k, j]
        for j in range(i):
            F[i, j] /= minv[i, i]
        F[i, i] = 1.0 / minv[i, i]
    minv[:] = 0.0
    for k in range(n):
        for i in range(k + 1):
            x = F[k, i]
            for j in range(i + 1):
                minv[i, j] += x * F[k, j]
    for i in range(n):
        for j in range(i):
            minv[j, i] = minv[i, j]
    parts = np.empty((3, n))
    forces(damping, stiffness, kp, kd, tau, stretch, v, v, h, theta, parts)
    for j in range(n):
        force[j] = parts[0, j] + parts[1, j] + parts[2, j]
    return True


@kernel
def command(control, angle, turning, out):
    """Joint forces of a control (kp, kd, target, constant, limit) at rest at the angles, into out (n,).

    To the target it is the short way round where a joint is `turning` (n,), given by cos and sin.
    """
    kp, _, target, constant, _ = control
    for j in range(out.size):
        deviation = angle[j] - target[j]
        if turning[j]:
            deviation = (deviation + math.pi) % (2.0 * math.pi) - math.pi
        out[j] = constant[j] - kp[j] * deviation


@kernel
def saturated(control, tau, v0, v1, h, theta, held, side):
    """Whether a `command` tau is elsewhere at its limit than at the `side` (n,) of it, -1, 0 or 1, taken so far.

    Side is changed to where it is; what is at its limit stays there where it is to be `held`.
    """
    kp, kd, _, _, limit = control
    some = False
    for j in range(side.size):
        wanted = tau[j] - kd[j] * v1[j] - kp[j] * h * (v1[j] - (1.0 - theta) * v0[j])
        new = math.copysign(1.0, wanted) if abs(wanted) > limit[j] else 0.0
        if new != side[j] and not (held and side[j] != 0.0):
            side[j] = new
            some = True
    return some


@kernel
def loaded(M, laws, weight, control, own, v0, h, theta, matrices, v):
    """Velocity v (n,) after the forces of a step on a tree without constraints.

    laws = (damping, stiffness, kp, kd, tau, stretch); F, m and minv of `implicit` into matrices (3, n, n). Returns
    whether it has a positive definite m, and whether its control, of which tau has its `own`, is beyond its limit.
    """
    force, side = np.empty(v0.size), np.zeros(v0.size)
    v[:] = v0
    if not implicit(M, *laws, v0, h, theta, matrices[0], matrices[1], matrices[2], force):
        return False, False
    respond(v0, matrices[2], force, weight, h, v)
    return True, saturated(control, own, v0, v, h, theta, False, side)


@kernel
def forces(damping, stiffness, kp, kd, tau, stretch, v0, v1, h, theta, out):
    """Actuation, damping and springs of a step, from the velocities before and after its forces, into out (3, n)."""
    for j in range(v0.size):
        out[0, j] = tau[j] - kd[j] * v1[j] - kp[j] * h * (v1[j] - (1.0 - theta) * v0[j])
        out[1, j] = -damping[j] * (theta * v1[j] + (1.0 - theta) * v0[j])
        move = h * (theta * theta * v1[j] - (1.0 - theta) * (1.0 - theta) * v0[j])
        out[2, j] = -stiffness[j] * (stretch[j] + move)


@kernel
def works(laws, velocities, mean, push, impulse, h, theta, joints):
    """Works of actuation, of damping and of an impulse on the velocity `mean` (n,), J.

    laws = (damping, stiffness, kp, kd, tau, stretch), velocities before and after. The impulses of actuation, without
    what wrenches `push` (n,), into joints (n,).
    """
    parts = np.empty((3, mean.size))
    forces(*laws, *velocities, h, theta, parts)
    actuation, dissipation, pushed = 0.0, 0.0, 0.0
    for j in range(mean.size):
        joints[j] = h * (parts[0, j] - push[j])
        actuation += h * mean[j] * parts[0, j]
        dissipation += h * mean[j] * parts[1, j]
        pushed += mean[j] * impulse[j]
    return actuation, dissipation, pushed


@kernel
def respond(start, minv, force, bias, h, v):
    """Velocity v = start + h minv (force - bias), into v (n,); returns its relative change."""
    change, size = 0.0, 0.0
    for i in range(v.size):
        x = start[i]
        for j in range(v.size):
            x += h * minv[i, j] * (force[j] - bias[j])
        change, size = max(change, abs(x - v[i])), max(size, abs(x))
        v[i] = x
    return change / size if size > 0.0 else 0.0


@kernel
def first_order(v, a, h, out):
    """Of a motion at first order: displacement, the velocity at its end, the mean velocity, into out (3, n)."""
    for j in range(v.size):
        change = h * a[j]
        mean = v[j] + 0.5 * change
        out[0, j], out[1, j], out[2, j] = h * mean, v[j] + change, mean


@kernel
def combine(v1, v2, v3, v4, a1, a2, a3, a4, h, out):
    """Of a Runge–Kutta step: two displacements, the velocity at its end, the mean velocity, into out (4, n)."""
    for j in range(v1.size):
        middle = 2.0 * (v2[j] + v3[j])
        out[0, j] = h / 12.0 * (3.0 * v1[j] + middle - v4[j])
        out[1, j] = h / 12.0 * (middle + 3.0 * v4[j] - v1[j])
        out[2, j] = v1[j] + h / 6.0 * (a1[j] + 2.0 * (a2[j] + a3[j]) + a4[j])
        out[3, j] = (v1[j] + middle + v4[j]) / 6.0


@kernel
def fastest(v, turns):
    """(largest entry of |v|, the same of those coordinates that turn)."""
    most, turn = 0.0, 0.0
    for j in range(v.size):
        most = max(most, abs(v[j]))
        if turns[j]:
            turn = max(turn, abs(v[j]))
    return most, turn


@kernel
def gather(x, R, joints, q, scalar, place, x_out, R_out, angle):
    """Poses of some joints, from (n, 3), (n, 3, 3) into x_out and R_out; q[place] to angle[scalar]."""
    for k in range(scalar.size):
        angle[scalar[k]] = q[place[k]]
    for k in range(joints.size):
        for i in range(3):
            x_out[k, i] = x[joints[k], i]
            for j in range(3):
                R_out[k, i, j] = R[joints[k], i, j]


@kernel
def quaternions(R, out):
    """Unit quaternions xyzw of rotation matrices, w >= 0 unless the turn is near half, into out (n, 4)."""
    for b in range(R.shape[0]):
        trace = R[b, 0, 0] + R[b, 1, 1] + R[b, 2, 2]
        if trace > 0.0:
            s = 2.0 * math.sqrt(1.0 + trace)
            out[b, 3] = 0.25 * s
            for i in range(3):
                j, k = (i + 1) % 3, (i + 2) % 3
                out[b, i] = (R[b, k, j] - R[b, j, k]) / s
        else:
            i = 0
            if R[b, 1, 1] > R[b, 0, 0]:
                i = 1
            if R[b, 2, 2] > R[b, i, i]:
                i = 2
            j, k = (i + 1) % 3, (i + 2) % 3
            s = 2.0 * math.sqrt(1.0 + R[b, i, i] - R[b, j, j] - R[b, k, k])
            out[b, i] = 0.25 * s
            out[b, j] = (R[b, i, j] + R[b, j, i]) / s
            out[b, k] = (R[b, i, k] + R[b, k, i]) / s
            out[b, 3] = (R[b, k, j] - R[b, j, k]) / s


@kernel
def link_rows(frame1, frame2, point, frame, first, support, J, start, H):
    """Add the rows of Hᵀ on the links of one tree to H.

    Its frames are first, first + 1, ...; column j of J (6, nv) is the velocity field of coordinate j in world axes,
    linear at the world's origin, then angular; it moves frame f if support[f - first, j]. A contact between two links
    adds both to side 0.
    """
    last, nv = first + support.shape[0], J.shape[1]
    for c in range(frame1.size):
        inside = first <= frame1[c] < last
        for s in range(2):
            f = frame1[c] if s == 0 else frame2[c]
            if f < first or f >= last:
                continue
            sign = -1.0 if s == 0 else 1.0
            side = 0 if inside else s
            p0, p1, p2 = point[c, 0], point[c, 1], point[c, 2]
            for i in range(3):
                d0, d1, d2 = sign * frame[c, i, 0], sign * frame[c, i, 1], sign * frame[c, i, 2]
                m0, m1, m2 = p1 * d2 - p2 * d1, p2 * d0 - p0 * d2, p0 * d1 - p1 * d0
                row = start[c, side] + nv * i
                for j in range(nv):
                    if support[f - first, j]:
                        H[row + j] += (
                            d0 * J[0, j] + d1 * J[1, j] + d2 * J[2, j] + m0 * J[3, j] + m1 * J[4, j] + m2 * J[5, j]
                        )


@kernel
def link_twists(x, support, J, v, linear, angular):
    """Velocities of the origins x (k, 3) of some frames, and of their rotations, world axes, into (k, 3) each."""
    for f in range(support.shape[0]):
        linear[f], angular[f] = 0.0, 0.0
        for j in range(v.size):
            if support[f, j]:
                for i in range(3):
                    linear[f, i] += J[i, j] * v[j]
                    angular[f, i] += J[3 + i, j] * v[j]
        w = angular[f]
        linear[f, 0] += w[1] * x[f, 2] - w[2] * x[f, 1]
        linear[f, 1] += w[2] * x[f, 0] - w[0] * x[f, 2]
        linear[f, 2] += w[0] * x[f, 1] - w[1] * x[f, 0]


@kernel
def link_reach(x, support, J, v, h, radius, fall, out):
    """How far any point of each link's shapes moves in a step of h at velocity v, and by `fall`, m, into out (n,)."""
    linear, angular = np.empty(x.shape), np.empty(x.shape)
    link_twists(x, support, J, v, linear, angular)
    for f in range(support.shape[0]):
        a, w = linear[f], angular[f]
        speed, spin = math.sqrt(a[0] ** 2 + a[1] ** 2 + a[2] ** 2), math.sqrt(w[0] ** 2 + w[1] ** 2 + w[2] ** 2)
        out[f] = h * (speed + spin * radius[f]) + fall


@kernel
def active_rows(coordinate, sign, bound, near, angle, v, v_free, h, rows):
    """The joint rows of a step into rows: all friction (sign 0), and the limits that the joint may reach; how many."""
    count = 0
    for k in range(coordinate.size):
        c = coordinate[k]
        rate = max(abs(v[c]), abs(v_free[c]))
        if sign[k] == 0.0 or sign[k] * (angle[c] - bound[k]) <= near[k] + 2.0 * h * rate:
            rows[count] = k
            count += 1
    return count


@kernel
def gaps(slots, coordinate, sign, bound, angle, out):
    """Distances to the limits of some joint rows, rad or m, 0 for friction, into out."""
    for i in range(slots.size):
        k = slots[i]
        out[i] = sign[k] * (angle[coordinate[k]] - bound[k])


@kernel
def append_rows(slots, coordinate, tree, sign, blocks):
    """Contacts followed by the joint rows of the given slots, as blocks."""
    offset, block, start, H, m_start, m, minv = blocks
    nc, nj, size = block.shape[0], slots.size, H.size
    new_block, new_start = np.full((nc + nj, 2), -1, np.int64), np.empty((nc + nj, 2), np.int64)
    new_block[:nc], new_start[:nc] = block, start
    for i in range(nj):
        k = tree[slots[i]]
        new_block[nc + i, 0] = k
        new_start[nc + i, 0] = new_start[nc + i, 1] = size
        size += 3 * (offset[k + 1] - offset[k])
    new_H = np.zeros(size)
    new_H[: H.size] = H
    for i in range(nj):
        k = tree[slots[i]]
        at = new_start[nc + i, 0] + coordinate[slots[i]] - offset[k]
        if sign[slots[i]] == 0.0:
            new_H[at + offset[k + 1] - offset[k]] = 1.0
        else:
            new_H[at] = sign[slots[i]]
    return offset, new_block, new_start, new_H, m_start, m, minv


@kernel
def reduce_rows(blocks, bases, z_start, z, pressed, press):
    """The factors in the coordinates y that constraints leave, v = Z y, and those of joint friction after them.

    Block bases[i] has Z (n, ny) with Zᵀ M Z = I at z[z_start[i]:z_start[i + 1]]. Row pressed[i] gets a block of one
    coordinate as its side 1, as mobile as its joint, and there the normal velocity -press[i] times that mobility.
    Returns the new blocks, where each block's Z begins in z (-1: it is I), velocities.
    """
    offset, block, start, H, m_start, m, minv = blocks
    nb, nc, np_ = offset.size - 1, block.shape[0], pressed.size
    where, sizes = np.full(nb, -1, np.int64), np.ones(nb + np_, np.int64)
    for k in range(nb):
        sizes[k] = offset[k + 1] - offset[k]
    for i in range(bases.size):
        where[bases[i]] = z_start[i]
        sizes[bases[i]] = (z_start[i + 1] - z_start[i]) // sizes[bases[i]]
    new_offset, new_m_start = np.zeros(nb + np_ + 1, np.int64), np.zeros(nb + np_ + 1, np.int64)
    for k in range(nb + np_):
        new_offset[k + 1], new_m_start[k + 1] = new_offset[k] + sizes[k], new_m_start[k] + sizes[k] * sizes[k]
    new_m, new_minv = np.zeros(new_m_start[-1]), np.zeros(new_m_start[-1])
    for k in range(nb):
        first, n = new_m_start[k], sizes[k]
        if where[k] < 0:
            new_m[first : first + n * n] = m[m_start[k] : m_start[k] + n * n]
            new_minv[first : first + n * n] = minv[m_start[k] : m_start[k] + n * n]
        else:
            for j in range(n):
                new_m[first + j * n + j] = new_minv[first + j * n + j] = 1.0
    new_block, new_start, velocity = block.copy(), np.empty_like(start), np.zeros(3 * nc)
    for i in range(np_):
        c, k = pressed[i], block[pressed[i], 0]
        n, row = offset[k + 1] - offset[k], start[pressed[i], 0] + offset[k + 1] - offset[k]
        mobility = 0.0
        for a in range(n):
            for b in range(n):
                mobility += H[row + a] * minv[m_start[k] + a * n + b] * H[row + b]
        if mobility <= 0.0:  # a joint that cannot move
            mobility = 1.0
        new_block[c, 1] = nb + i
        velocity[3 * c] = -press[i] * mobility
        new_m[new_m_start[nb + i]], new_minv[new_m_start[nb + i]] = 1.0 / mobility, mobility
    size = 0
    for c in range(nc):
        for s in range(2):
            new_start[c, s] = size
            if new_block[c, s] >= 0:
                size += 3 * sizes[new_block[c, s]]
    new_H = np.zeros(size)
    for c in range(nc):
        for s in range(2):
            k, b = new_block[c, s], new_start[c, s]
            if k >= nb:
                new_H[b] = 1.0
            elif k >= 0:
                a, n, ny = start[c, s], offset[k + 1] - offset[k], sizes[k]
                for i in range(3):
                    for j in range(ny):
                        if where[k] < 0:
                            new_H[b + i * ny + j] = H[a + i * n + j]
                        else:
                            for l in range(n):
                                new_H[b + i * ny + j] += H[a + i * n + l] * z[where[k] + l * ny + j]
    return (new_offset, new_block, new_start, new_H, new_m_start[:-1], new_m, new_minv), where, velocity


@kernel
def expand(offset, z_start, z, new_offset, y, v):
    """Velocity v = Z y, block by block, into v (n,)."""
    for k in range(offset.size - 1):
        o, n, p, ny = offset[k], offset[k + 1] - offset[k], new_offset[k], new_offset[k + 1] - new_offset[k]
        for i in range(n):
            if z_start[k] < 0:
                v[o + i] = y[p + i]
            else:
                total = 0.0
                for j in range(ny):
                    total += z[z_start[k] + i * ny + j] * y[p + j]
                v[o + i] = total


@kernel
def surface_velocities(geom, motion_of_geom, origin, linear, angular, slides, point, normal, sign, w):
    """Add the velocity of prescribed bodies at the contacts, times sign, to w (nc, 3), world axes.

    Motion m has the velocity linear[m] + angular[m] x (p - origin[m]); where it slides in itself (a conveyor), only
    the tangential part counts.
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
