"""Layout of states in a few arrays, and views of these arrays.

For a few bodies, passing many arguments to a kernel takes longer than the computation. A state is therefore one array
of floats: first its results, then the columns of the frames, of the coordinates and of the contacts, one after the
other. The size of a scene is (frames, coordinates, free bodies); the frames of free bodies come first.
"""

from nsdyn._kernels.compiled import kernel
from nsdyn._kernels.packing import indices, matrices, numbers, triples

# The packed arrays of the system: floats, then integers.
MOMENTS, AXES, INVERSE_MASS, INVERSE_J, MASS, INERTIA, M, MINV, GRAVITY, NO_LOAD = range(10)
RADII, NOWHERE, INSCRIBED, ROUNDING, JACOBIAN, BEGUN, NUMBERS, SYSTEM = range(10, 18)
NODE, OFFSET, M_START, TREES, SUPPORT = range(5)

# The last array of the floats: numbers with the names that they have in `System` and `GapRule`, then in `Auto` and
# `gauss`; then the number of geoms, the most numbers in H per contact, up to how many contacts other solutions are
# searched, and whether Python has computed the first half of the move.
WEIGHT, STEP, THETA, GAP_TOL, SHALLOW, UNTIL, DEPTH, FASTEST, LEAST_PENETRATION, STILL, ELASTIC, HALF, LEAST = range(13)
TOL, OWN, ENOUGH, GOOD, DENSE, PENALTY, MAX_ITER, WEAK = range(13, 21)
GEOMS, WIDE, FEWEST, GIVEN = range(21, 25)

# The results of a step: energies and works, the measures of its solution, its certificate, and what it needed.
KINETIC, POTENTIAL, EXTERNAL, NORMAL, FRICTION, DAMPING, CONSTRAINT, NUMERICS = range(8)
NORM, ERROR, RESIDUAL, COUNT, TIME, CERTIFIED = range(8, 14)
GAP, SHIFT, BOUND, COULOMB, WENT, GOES, SUSPECT, RESULTS = range(14, 22)

# First columns of a frame in a state, and in the work array, where the first three are the same; only quaternions of
# free bodies are used.
X, QUATERNION, R, LINEAR, ANGULAR, DETECTED_AT, FRAME = 0, 3, 7, 16, 19, 22, 35
REACH, DETECTED_THERE, NEAR, FRAME_WORK = 16, 17, 30, 31

# Columns of the coordinates, behind those of the frames: (number of frame columns, index of the column).
V, RATE = (FRAME, 0), (FRAME, 1)
V_THERE, V_FREE, V_PLUS, TURN, CHANGE, V_TURNED, V_MEAN, PUSHED = [(FRAME_WORK, k) for k in range(8)]
COORDINATE, COORDINATE_WORK = 2, 8

# First columns of a contact in a state, in detected contacts (H last), and in the work array.
FORCE, IMPULSE, U, FREE, U_END, NORMAL_WORK, FRICTION_WORK = 0, 3, 6, 9, 12, 15, 16
GAP_END, COUPLE, CONTACT = 17, 18, 21
FRAMES, SCALES, ROWS = 15, 24, 25
BLOCKS, STARTS, FOUND_NAMES, SIZE, MADE = 5, 7, 9, 0, 1
LOCAL, ALONE, FORESEEN, EXCESS_SPEED, PROJECTED, COUPLE_WORK, LEFT_OVER = 0, 15, 30, 31, 32, 35, 36
ISLANDS, KEPT, CONTACT_WORK = 37, 40, 46

# The first integers of the work array: numbers of contacts at the midpoint, at the end, and in the active set; whether
# the active set is not all of those at the midpoint; next keys at the midpoint and at the end; how often impulses may
# be solved once more; whether they have been; whether couples act; how many contacts need memory; whether a body is so
# fast that detection may miss a contact; whether Python has solved a problem; two integers of the clock.
MIDDLE, END, ACTIVE, SOME, KEY_MIDDLE, KEY_END, PASSES_LEFT, AGAIN, TURNED, NEEDED, FAST, SOLVED, CLOCK = range(13)
HEAD = CLOCK + 2

# Flags of the contacts, the first index of the flags array.
SLIDES, STAYS, STICKS, LEVER, OTHER, OFF, FLAGS = range(7)


@kernel(inline="always")
def opened(system):
    """Views of the packed arrays of a system.

    (numbers, size); (radii, nowhere, inscribed, rounding); (mass, J); (moments, axes, 1/mass, J⁻¹) of bodies;
    (gravity, no load); masses = (node, offset, m_start, m, minv); movers = (free bodies, trees as in `links.rows`) at
    the midpoint, and the same at the beginning of the move.
    """
    sf, si = system
    num, mass, J = numbers(sf, si, NUMBERS), numbers(sf, si, MASS), matrices(sf, si, INERTIA)
    near = numbers(sf, si, RADII), numbers(sf, si, NOWHERE), numbers(sf, si, INSCRIBED), numbers(sf, si, ROUNDING)
    offset = indices(si, OFFSET, SYSTEM)
    trees = indices(si, TREES, SYSTEM), indices(si, SUPPORT, SYSTEM)
    bodies = (
        triples(sf, si, MOMENTS),
        matrices(sf, si, AXES),
        numbers(sf, si, INVERSE_MASS),
        matrices(sf, si, INVERSE_J),
    )
    masses = (
        indices(si, NODE, SYSTEM),
        offset,
        indices(si, M_START, SYSTEM),
        numbers(sf, si, M),
        numbers(sf, si, MINV),
    )
    return (
        (num, (near[0].size, offset[offset.size - 1], mass.size)),
        near,
        (mass, J),
        bodies,
        (numbers(sf, si, GRAVITY), triples(sf, si, NO_LOAD)),
        masses,
        (mass.size, (*trees, numbers(sf, si, JACOBIAN))),
        (mass.size, (*trees, numbers(sf, si, BEGUN))),
    )


@kernel(inline="always")
def column(f, k, n):
    """The column k, n numbers."""
    return f[k * n : (k + 1) * n]


@kernel(inline="always")
def vectors(f, k, n):
    """The columns from k on as (n, 3)."""
    return f[k * n : (k + 3) * n].reshape((n, 3))


@kernel(inline="always")
def quaternions(f, k, n):
    """The columns from k on as (n, 4)."""
    return f[k * n : (k + 4) * n].reshape((n, 4))


@kernel(inline="always")
def rotations(f, k, n):
    """The columns from k on as (n, 3, 3)."""
    return f[k * n : (k + 9) * n].reshape((n, 3, 3))


@kernel(inline="always")
def velocity(f, k, size):
    """The column k of the coordinates, (n,)."""
    begin = k[0] * size[0] + k[1] * size[1]
    return f[begin : begin + size[1]]


@kernel(inline="always")
def poses(f, n):
    """(x, R) of the frames."""
    return vectors(f, X, n), rotations(f, R, n)


@kernel(inline="always")
def twists(f, n):
    """(linear, angular) velocities of the frames."""
    return vectors(f, LINEAR, n), vectors(f, ANGULAR, n)


@kernel(inline="always")
def answer(a, nc):
    """(r, y, b) of the contacts, y = W r + b."""
    return a[IMPULSE * nc : U * nc], a[U * nc : FREE * nc], a[FREE * nc : U_END * nc]


@kernel(inline="always")
def local(own, k, nc):
    """The columns from k on as (5, 3 nc), the result of `law.local_velocities`: `LOCAL`, or `ALONE` without couples."""
    return own[k * nc : (k + 15) * nc].reshape((5, 3 * nc))


@kernel(inline="always")
def placed(f, k, n):
    """(x, R, reach) of the columns from k on, as in `DetectionPose`."""
    return vectors(f, k, n), rotations(f, k + 3, n), column(f, k + 12, n)


@kernel(inline="always")
def contacts(found, nc):
    """(names, points, scalars) of detected contacts, in the layout of `gather`."""
    f, i = found
    return i[: 5 * nc].reshape((5, nc)), f[: 12 * nc].reshape((4, nc, 3)), f[12 * nc : 15 * nc].reshape((3, nc))


@kernel(inline="always")
def rows(found, nc):
    """(frame, block, start, H, scales, (size of H, whether H is computed)) of detected contacts."""
    f, i = found
    return (
        rotations(f, FRAMES, nc),
        i[BLOCKS * nc : STARTS * nc].reshape((nc, 2)),
        i[STARTS * nc : FOUND_NAMES * nc].reshape((nc, 2)),
        f[ROWS * nc :],
        column(f, SCALES, nc),
        i[FOUND_NAMES * nc :],
    )
