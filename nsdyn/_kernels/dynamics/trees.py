"""Free motion of an articulated tree, and the forces in its joints."""

import math

import numpy as np

from nsdyn._kernels.compiled import in_place, kernel


@in_place
def factor(m, F, minv):
    """F = L⁻¹ for the Cholesky factor L of m, and minv = m⁻¹ = Fᵀ F, all (n, n); False if not positive definite."""
    n = m.shape[0]
    for i in range(n):
        for j in range(n):
            minv[i, j] = m[i, j]
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
    return True


@kernel
def implicit(M, damping, stiffness, kp, kd, tau, stretch, v, h, theta, F, m, minv, force):
    """The forces linear in the velocity v' after the forces: the effective mass matrix, its inverse, and what is left.

    m = M + h (theta D + h theta² K + kd + h kp) and minv = Fᵀ F, where F = L⁻¹ for its Cholesky factor L, all (n, n);
    force (n,) is what `forces` gives for v' = v. False when m is not positive definite.
    """
    n = M.shape[0]
    for i in range(n):
        for j in range(n):
            m[i, j] = M[i, j]
        m[i, i] = m[i, i] + h * (theta * damping[i] + h * theta * theta * stiffness[i] + kd[i] + h * kp[i])
    if not factor(m, F, minv):
        return False
    parts = np.empty((3, n))
    forces(damping, stiffness, kp, kd, tau, stretch, v, v, h, theta, parts)
    for j in range(n):
        force[j] = parts[0, j] + parts[1, j] + parts[2, j]
    return True


@in_place
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


@in_place
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


@in_place
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


@in_place
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


@in_place
def settle(start, minv, bias, h, newton, rest, v):
    """One step of Newton's method to v = start - h minv bias(v), into v (n,), with the inverse matrix `newton`.

    Returns the relative change of v, nan where it is not finite; what is left of the equation goes into rest (n,).
    """
    change, size = 0.0, 0.0
    for i in range(v.size):
        rest[i] = start[i] - v[i]
        for j in range(v.size):
            rest[i] -= h * minv[i, j] * bias[j]
    for i in range(v.size):
        step = 0.0
        for j in range(v.size):
            step += newton[i, j] * rest[j]
        v[i] += step
        if not abs(v[i]) < math.inf:
            return math.nan
        change, size = max(change, abs(step)), max(size, abs(v[i]))
    return change / size if size > 0.0 else 0.0


@kernel
def closing(G, N, phi, damping, step):
    """Add -N Gᵀ (G N Gᵀ + damping)⁻¹ phi to step (n,), damping as a fraction of the diagonal.

    False where that matrix is not positive definite.
    """
    m, n = G.shape
    A, F, inverse, scale = np.zeros((m, m)), np.empty((m, m)), np.empty((m, m)), np.empty(m)
    side = np.zeros((m, n))
    for i in range(m):
        for k in range(n):
            for j in range(n):
                side[i, j] += G[i, k] * N[k, j]
    for i in range(m):
        for k in range(m):
            for j in range(n):
                A[i, k] += side[i, j] * G[k, j]
    for i in range(m):
        scale[i] = math.sqrt(A[i, i]) if A[i, i] > 0.0 else 1.0
    for i in range(m):
        for k in range(m):
            A[i, k] /= scale[i] * scale[k]
        A[i, i] += damping
    if not factor(A, F, inverse):
        return False
    for i in range(m):
        force = 0.0
        for k in range(m):
            force += inverse[i, k] * phi[k] / scale[k]
        for j in range(n):
            step[j] -= side[i, j] * force / scale[i]
    return True


@in_place
def midpoint(v1, v2, a1, a2, h, tolerance, floor, out):
    """Of a step by the midpoint rule: displacement and the velocity at its end, into out (4, n).

    Whether it goes on as it began, and its acceleration changes so little that even the first order would do.
    """
    change, size, rise = 0.0, 0.0, 0.0
    for j in range(v1.size):
        out[0, j], out[1, j] = h * v2[j], v1[j] + h * a2[j]
        if not abs(a1[j]) + abs(a2[j]) + abs(v1[j]) < math.inf:
            return False
        change, rise, size = max(change, abs(a2[j] - a1[j])), max(rise, abs(a2[j])), max(size, abs(v1[j]))
    return h * rise <= 0.5 * size and h * change <= tolerance * size + floor


@in_place
def combine(v1, v2, v3, v4, a1, a2, a3, a4, h, tolerance, floor, out):
    """Of a Runge–Kutta step: two displacements, the velocity at its end, the mean velocity, into out (4, n).

    Its error, of that allowed: see `nsdyn.dynamics.runge_kutta`.
    """
    error, size = 0.0, 0.0
    for j in range(v1.size):
        middle = 2.0 * (v2[j] + v3[j])
        mean = (a1[j] + 2.0 * (a2[j] + a3[j]) + a4[j]) / 6.0
        out[0, j] = h / 12.0 * (3.0 * v1[j] + middle - v4[j])
        out[1, j] = h / 12.0 * (middle + 3.0 * v4[j] - v1[j])
        out[2, j] = v1[j] + h * mean
        out[3, j] = (v1[j] + middle + v4[j]) / 6.0
        d, most = h * abs(mean - a2[j]), max(abs(v1[j]), abs(v2[j]), abs(v3[j]), abs(v4[j]))
        if not d + most < math.inf:
            return math.inf
        error, size = max(error, d), max(size, most)
    # z⁵/120 where error = size z³/6.
    error = (6.0 * error / size) ** (5.0 / 3.0) / 120.0 * size if size > 0.0 else 0.0
    return error / (tolerance * size + floor)


@in_place
def fastest(v, turns):
    """(largest entry of |v|, the same of those coordinates that turn); infinite where an entry is not finite."""
    most, turn = 0.0, 0.0
    for j in range(v.size):
        if not abs(v[j]) < math.inf:
            return math.inf, math.inf
        most = max(most, abs(v[j]))
        if turns[j]:
            turn = max(turn, abs(v[j]))
    return most, turn
