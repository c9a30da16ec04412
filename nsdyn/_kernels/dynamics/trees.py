"""Free motion of an articulated tree, and the forces in its joints."""

import math

import numpy as np

from nsdyn._kernels.compiled import kernel, no_alloc
from nsdyn._kernels.vectors import along, cross, dot, minus, row, square, three, to_local

OVERSHOOT = 3.0
"""Largest value of δ (1 - β) and σ (1 - α) of `nsdyn.PD`. A motion that the damping stops overshoots by at most (3 -
1)/(3 + 1) in a step, and by less for larger δ. The knees of a quadruped have δ = 6 at 5 ms: with 2 its trot errs three
times as much; with 4 it errs as much as with 3, and rings longer."""


@no_alloc
def factor(m, F, minv):
    """Write F and minv = m⁻¹ = Fᵀ F, all (n, n); return False if m is not positive definite.

    The rows of F are L⁻¹ of the Cholesky factor L of m from its last coordinate to its first, that is, from the tips of
    a tree. In this order the zeros between its branches are kept.
    """
    n = m.shape[0]
    for i in range(n):
        for j in range(i, n):
            minv[i, j] = m[n - 1 - i, n - 1 - j]
    # All inner loops run along rows, so that the compiler vectorises them. Here minv becomes Lᵀ, in its upper half.
    for k in range(n):
        if not minv[k, k] > 0.0:
            return False
        minv[k, k] = math.sqrt(minv[k, k])
        for j in range(k + 1, n):
            minv[k, j] /= minv[k, k]
        for i in range(k + 1, n):
            x = minv[k, i]
            if x != 0.0:
                for j in range(i, n):
                    minv[i, j] -= x * minv[k, j]
    F[:] = 0.0
    for i in range(n):
        for k in range(i):
            x = minv[k, i]
            if x != 0.0:
                for j in range(k + 1):
                    F[i, j] -= x * F[k, j]
        for j in range(i):
            F[i, j] /= minv[i, i]
        F[i, i] = 1.0 / minv[i, i]
    minv[:] = 0.0
    for k in range(n):
        for j in range(n // 2):
            F[k, j], F[k, n - 1 - j] = F[k, n - 1 - j], F[k, j]
        for i in range(n - 1 - k, n):
            x = F[k, i]
            if x != 0.0:
                for j in range(i, n):
                    minv[i, j] += x * F[k, j]
    for i in range(n):
        for j in range(i):
            minv[i, j] = minv[j, i]
    return True


@no_alloc
def excess(angle, goal, turning):
    """Angle - goal; for a `turning` joint, given by cos and sin, the short way round."""
    out = angle - goal
    return (out + math.pi) % (2.0 * math.pi) - math.pi if turning else out


@no_alloc
def strain(angle, springs, turning):
    """Energy of joint springs, (stiffness, damping, rest) (3, n), J."""
    energy = 0.0
    for j in range(angle.size):
        energy += 0.5 * springs[0, j] * square(excess(angle[j], springs[2, j], turning[j]))
    return energy


@kernel
def linear_laws(M, springs, control, angle, turning, h, theta, laws):
    """Laws in a step of joint springs, (stiffness, damping, rest) (3, n), and of a control, `Control` (5, n).

    Both have the form τ = f - k h (α² v' - (1 - α)² v0) - d (β v' + (1 - β) v0). Their (k, d, α, β, f) are written into
    laws (2, 5, n). f is the force at rest at the angles where the forces act. Springs have α = β = θ. A control has
    larger α and β where its joint has little inertia, 1/M⁻¹_jj, see `OVERSHOOT`. A control without gains is clipped at
    its limit.
    """
    n = angle.size
    stiffness, damping, rest = springs[0], springs[1], springs[2]
    kp, kd, target, constant, limit = control[0], control[1], control[2], control[3], control[4]
    gains = False
    for j in range(n):
        laws[0, 0, j], laws[0, 1, j], laws[0, 2, j], laws[0, 3, j] = stiffness[j], damping[j], theta, theta
        laws[0, 4, j] = -stiffness[j] * excess(angle[j], rest[j], turning[j])
        laws[1, 0, j], laws[1, 1, j], laws[1, 2, j], laws[1, 3, j] = kp[j], kd[j], theta, theta
        laws[1, 4, j] = constant[j] - kp[j] * excess(angle[j], target[j], turning[j])
        if kp[j] > 0.0 or kd[j] > 0.0:
            gains = True
        else:
            laws[1, 4, j] = min(max(constant[j], -limit[j]), limit[j])
    if not gains:
        return
    F, mobility = np.empty((n, n)), np.empty((n, n))
    if not factor(M, F, mobility):
        return
    for j in range(n):
        damps = h * kd[j] * mobility[j, j]
        swings = h * h * kp[j] * mobility[j, j] / (1.0 + 0.5 * damps)
        if swings * (1.0 - theta) > OVERSHOOT:
            laws[1, 2, j] = 1.0 - OVERSHOOT / swings
        if damps * (1.0 - theta) > OVERSHOOT:
            laws[1, 3, j] = 1.0 - OVERSHOOT / damps


@no_alloc
def parts(laws, l, j, v0, v1, h):
    """(elastic, viscous) force of a law in joint j, from the velocities before and after the forces of a step."""
    k, d, alpha, beta, f = laws[l, 0, j], laws[l, 1, j], laws[l, 2, j], laws[l, 3, j], laws[l, 4, j]
    move = h * (alpha * alpha * v1[j] - (1.0 - alpha) * (1.0 - alpha) * v0[j])
    return f - k * move, -d * (beta * v1[j] + (1.0 - beta) * v0[j])


@no_alloc
def forces(laws, push, v0, v1, h, out):
    """Write actuation plus `push` of wrenches, damping, and springs of a step into out (3, n).

    The velocities are as in `parts`.
    """
    for j in range(v0.size):
        elastic, viscous = parts(laws, 1, j, v0, v1, h)
        out[0, j] = elastic + viscous + push[j]
        out[2, j], out[1, j] = parts(laws, 0, j, v0, v1, h)


@no_alloc
def strained(laws, limit, last, v0, v1, h, over):
    """Write into over (n,) which controls exceed their limits, or were at them in the `last` impulses of their rows.

    Returns True if there are any.
    """
    some = False
    for j in range(v0.size):
        elastic, viscous = parts(laws, 1, j, v0, v1, h)
        slipped = laws[1, 0, j] + laws[1, 1, j] > 0.0 and 0.0 < last[j, 0] <= abs(last[j, 1])
        over[j] = abs(elastic + viscous) > limit[j] or slipped
        some = some or over[j]
    return some


@kernel
def works(loads, velocities, mean, impulse, h, start, joints):
    """Works of actuation, of damping and of an impulse, J: on the mean velocity, of damping on that of `velocities`.

    loads = (laws, push, limit), as in `forces`, with the largest forces of actuators, N m or N. `velocities` has those
    before and after the forces. The function writes impulses into joints (8, .), from column `start` on: of actuation
    without wrenches into row 0, of wrenches into row 3, and the largest of actuators into row 5.
    """
    laws, push, limit = loads
    acting = np.empty((3, mean.size))
    forces(laws, push, velocities[0], velocities[1], h, acting)
    actuation, dissipation, pushed = 0.0, 0.0, 0.0
    for j in range(mean.size):
        joints[0, start + j] += h * (acting[0, j] - push[j])
        joints[3, start + j], joints[5, start + j] = h * push[j], h * limit[j]
        actuation += h * mean[j] * acting[0, j]
        dissipation += h * 0.5 * (velocities[0][j] + velocities[1][j]) * acting[1, j]
        pushed += mean[j] * impulse[j]
    return actuation, dissipation, pushed


@kernel
def respond(start, minv, loads, v0, h, v):
    """Velocity v = start + h minv f after the forces of a step at the velocity v0, into v (n,).

    `start` is the velocity without the forces: v0 itself for a tree without constraints. loads = (laws, push, weight),
    as in `forces`, with the gravity terms, N m or N.
    """
    laws, push, weight = loads
    acting = np.empty((3, v.size))
    forces(laws, push, v0, v0, h, acting)
    for i in range(v.size):
        v[i] = start[i]
        for j in range(v.size):
            v[i] += h * minv[i, j] * (acting[0, j] + acting[1, j] + acting[2, j] - weight[j])


@no_alloc
def move_free(M, loads, v0, h, F, m, minv, v):
    """Velocity of a tree without constraints after the loads of `respond`, into v (n,).

    The effective mass matrix M + h (β d + h α² k) of all `linear_laws` and its inverse Fᵀ F are written into m, F and
    minv, all (n, n). Returns False if m is not positive definite.
    """
    n, laws = v.size, loads[0]
    for i in range(n):
        for j in range(n):
            m[i, j] = M[i, j]
        for l in range(2):
            m[i, i] += h * (laws[l, 3, i] * laws[l, 1, i] + h * square(laws[l, 2, i]) * laws[l, 0, i])
    if not factor(m, F, minv):
        return False
    respond(v0, minv, loads, v0, h, v)
    return True


@no_alloc
def settle(start, minv, bias, h, newton, rest, v):
    """One Newton step for v = start - h minv bias(v), into v (n,), with the inverse matrix `newton`.

    Returns the relative change of v, nan if it is not finite; the residual of the equation is written into rest (n,).
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

    Returns False if that matrix is not positive definite.
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


@no_alloc
def stage(k, v, a, h, x):
    """Stage k = 2, 3, 4 of a Runge–Kutta step from v into x (7, n); a is the acceleration of the stage before.

    The velocity of the stage is written into x[k - 2]. The displacement to its position is written into x[3]; that of
    stage 4 starts at the position of stage 2.
    """
    for j in range(v.size):
        if k == 4:
            x[2, j], x[3, j] = v[j] + h * a[j], h * x[1, j] - 0.5 * h * v[j]
        else:
            x[3, j] = 0.5 * h * (v[j] if k == 2 else x[0, j])
            x[k - 2, j] = v[j] + 0.5 * h * a[j]


@no_alloc
def outset(v, a, h, slow, x):
    """Begin a step: finish it with a constant acceleration if v and its change are `slow`; return True if they are.

    The step is written into rows of x (7, n): displacement 3, velocity at its end 5, mean 6. If the motion is not slow,
    x gets the second stage of a Runge–Kutta step, see `stage`.
    """
    size, rise = 0.0, 0.0
    for j in range(v.size):
        size, rise = max(size, abs(v[j])), max(rise, abs(a[j]))
    if not (h * size <= slow and h * rise <= slow * size):
        stage(2, v, a, h, x)
        return False
    for j in range(v.size):
        x[5, j], x[6, j] = v[j] + h * a[j], v[j] + 0.5 * h * a[j]
        x[3, j] = h * x[6, j]
    return True


@no_alloc
def midpoint(v, a1, a2, h, tolerance, floor, x):
    """Finish a step by the midpoint rule, with x of `stage`, if it is exact enough; return True if it is.

    The displacement is written into x[3], and the velocity at the end into x[5]. The rule is exact enough if the
    velocity changes little in the step, and the acceleration so little that even first order would do.
    """
    change, size, rise = 0.0, 0.0, 0.0
    for j in range(v.size):
        if not abs(a1[j]) + abs(a2[j]) + abs(v[j]) < math.inf:
            return False
        change, rise, size = max(change, abs(a2[j] - a1[j])), max(rise, abs(a2[j])), max(size, abs(v[j]))
    if h * rise > 0.5 * size or h * change > tolerance * size + floor:
        return False
    for j in range(v.size):
        x[3, j], x[5, j] = h * x[0, j], v[j] + h * a2[j]
    return True


@no_alloc
def combine(v, accelerations, h, tolerance, floor, x):
    """Finish a Runge–Kutta step from v; return its error over the allowed one, see `nsdyn.dynamics.runge_kutta`.

    `accelerations` are those of the four stages. The allowed error is a fraction of the largest velocity, plus a floor.
    Two displacements, the velocity at the end and the mean velocity are written into x (7, n) of `stage` from row 3 on.
    """
    a1, a2, a3, a4 = accelerations
    error, size = 0.0, 0.0
    for j in range(v.size):
        v2, v3, v4 = x[0, j], x[1, j], x[2, j]
        middle = 2.0 * (v2 + v3)
        mean = (a1[j] + 2.0 * (a2[j] + a3[j]) + a4[j]) / 6.0
        x[3, j] = h / 12.0 * (3.0 * v[j] + middle - v4)
        x[4, j] = h / 12.0 * (middle + 3.0 * v4 - v[j])
        x[5, j] = v[j] + h * mean
        x[6, j] = (v[j] + middle + v4) / 6.0
        d, most = h * abs(mean - a2[j]), max(abs(v[j]), abs(v2), abs(v3), abs(v4))
        if not d + most < math.inf:
            return math.inf
        error, size = max(error, d), max(size, most)
    # The error is z⁵/120 of the velocity if the difference is z³/6 of it.
    error = (6.0 * error / size) ** (5.0 / 3.0) / 120.0 * size if size > 0.0 else 0.0
    return error / (tolerance * size + floor)


@no_alloc
def fastest(v, turns):
    """(largest entry of |v|, the largest among turning coordinates); both infinite if an entry is not finite."""
    most, turn = 0.0, 0.0
    for j in range(v.size):
        if not abs(v[j]) < math.inf:
            return math.inf, math.inf
        most = max(most, abs(v[j]))
        if turns[j]:
            turn = max(turn, abs(v[j]))
    return most, turn


@no_alloc
def carry(lacking, way, whole, poses, q, v):
    """Give a tree momenta as one rigid body, and move it by a way.

    Parameters
    ----------
    lacking : ndarray, shape (6,)
        Momenta, N·s, and about the centre of mass, N·m·s, world axes.
    way : ndarray, shape (3,)
        m, world axes.
    whole : tuple
        Inertia about the centre of mass in world axes (3, 3), kg m², mass, kg, and centre of mass (3,), m.
    poses : tuple
        Positions and rotations of all joints, and the rotation of the placement of the base, joint 1.
    q, v : ndarray, shapes (nq,), (nv,)
        Changed in place: the first three of q, in the axes of that placement, and the first six of v, in those of the
        base.
    """
    (inertia, mass, centre), (x, R, placement) = whole, poses
    a, b, c = row(inertia, 0), row(inertia, 1), row(inertia, 2)
    L, volume = three(lacking, 3), dot(a, cross(b, c))
    turn = dot(L, cross(b, c)) / volume, dot(L, cross(c, a)) / volume, dot(L, cross(a, b)) / volume
    shift = along(cross(turn, minus(row(x, 1), centre)), 1.0 / mass, three(lacking, 0))
    shift, turn = to_local(R, 1, shift), to_local(R, 1, turn)
    for i in range(3):
        v[i] += shift[i]
        v[3 + i] += turn[i]
        for j in range(3):
            q[i] += placement[j, i] * way[j]
