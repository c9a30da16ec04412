"""States as a few arrays, and views of these.

What a call takes for its arguments is more than all that is done for a few bodies: a state is an array of floats, its
results first, then what it has of the frames, of the coordinates and of the contacts, one column after the other. The
size of a scene is (frames, coordinates, free bodies), the frames of which are the first.
"""

from nsdyn._kernels.compiled import kernel
from nsdyn._kernels.packing import indices, matrices, numbers, triples

# The packed arrays of the system: floats, then integers.
(
    MOMENTS,
    AXES,
    INVERSE_MASS,
    INVERSE_J,
    RADIUS,
    MASS,
    INERTIA,
    M,
    MINV,
    GRAVITY,
    NO_LOAD,
    ARM,
    NOWHERE,
    INSCRIBED,
    JACOBIAN,
    BEGUN,
    NUMBERS,
    SYSTEM,
) = range(18)
BLOCK_OF_FRAME, OFFSET, M_START, TREES, SUPPORT = range(5)

# The last of the floats: numbers, with the names that they have in `System`, `GapRule`, `Auto` and `gauss`; then how
# many there are in the rows of W of a contact at most, in how many contacts other solutions are looked for, and whether
# Python has made the first half of the move.
(
    WEIGHT,
    STEP,
    THETA,
    GAP_TOL,
    SHALLOW,
    UNTIL,
    DEPTH,
    FASTEST,
    LEAST_PENETRATION,
    STILL,
    ELASTIC,
    HALF,
    LEAST,
    TOL,
    OWN,
    ENOUGH,
    GOOD,
    DENSE,
    PENALTY,
    MAX_ITER,
    WEAK,
    GEOMS,
    WIDE,
    FEWEST,
    GIVEN,
) = range(25)

# The results of a step.
(
    KINETIC,
    POTENTIAL,
    EXTERNAL,
    NORMAL,
    FRICTION,
    DAMPING,
    CONSTRAINT,
    NUMERICS,
    NORM,
    ERROR,
    RESIDUAL,
    COUNT,
    TIME,
    CERTIFIED,
    GAP,
    SHIFT,
    BOUND,
    COULOMB,
    WENT,
    GOES,
    SUSPECT,
    RESULTS,
) = range(22)

# First columns of a frame in a state, and in what is at work; of the quaternions those of free bodies are used.
X, QUATERNION, R, LINEAR, ANGULAR, DETECTED_AT, FRAME = 0, 3, 7, 16, 19, 22, 35
R_THERE, REACH, DETECTED_THERE, NEAR, FRAME_WORK = 7, 16, 17, 30, 31

# Columns of the coordinates, behind those of the frames: how many these are, and which.
V, RATE = (FRAME, 0), (FRAME, 1)
V_THERE, V_FREE, V_PLUS, TURN, CHANGE, V_TURNED, V_MEAN, PUSHED = [(FRAME_WORK, k) for k in range(8)]
COORDINATE, COORDINATE_WORK = 2, 8

# First columns of a contact in a state, in what was found, whose rows of W come last, and in what is at work.
FORCE, IMPULSE, U, FREE, U_END, NORMAL_WORK, FRICTION_WORK, GAP_END, COUPLE, CONTACT = (
    0,
    3,
    6,
    9,
    12,
    15,
    16,
    17,
    18,
    21,
)
FRAMES, SCALES, ROWS = 15, 24, 25
BLOCKS, STARTS, FOUND_NAMES, SIZE, MADE = 5, 7, 9, 0, 1
LOCAL, ALONE, FORESEEN, EXCESS_SPEED, PROJECTED, COUPLE_WORK, LEFT_OVER, ISLANDS, KEPT, CONTACT_WORK = (
    0,
    15,
    30,
    31,
    32,
    35,
    36,
    37,
    40,
    46,
)

# The first of the integers at work: how many contacts there are where the impulses act, where the step ends, and of the
# former those that it meets; whether these are not all; keys of new ones; how often impulses may be sought once more;
# whether they have been; whether couples act; how many contacts there is no room for; whether anything is so fast that
# it might go unseen; whether Python has solved a problem; two of the clock.
MIDDLE, END, ACTIVE, SOME, KEY_MIDDLE, KEY_END, PASSES_LEFT, AGAIN, TURNED, NEEDED, FAST, SOLVED, CLOCK = range(13)
HEAD = CLOCK + 2

# Flags of the contacts.
SLIDES, STAYS, STICKS, OTHER, OFF, FLAGS = range(6)


@kernel(inline="always")
def opened(system):
    """Views of the packed arrays of a system.

    (numbers, size); (arm, nowhere, inscribed); (mass, J); (moments, axes, 1/mass, J⁻¹, radii) of bodies; (gravity, no
    load); masses = (block_of_frame, offset, m_start, m, minv); movers = (free bodies, trees as of `links.rows`) where
    the impulses act, and where the move begins.
    """
    sf, si = system
    num, mass, J = numbers(sf, si, NUMBERS), numbers(sf, si, MASS), matrices(sf, si, INERTIA)
    near = numbers(sf, si, ARM), numbers(sf, si, NOWHERE), numbers(sf, si, INSCRIBED)
    offset = indices(si, OFFSET, SYSTEM)
    trees = indices(si, TREES, SYSTEM), indices(si, SUPPORT, SYSTEM)
    bodies = (
        triples(sf, si, MOMENTS),
        matrices(sf, si, AXES),
        numbers(sf, si, INVERSE_MASS),
        matrices(sf, si, INVERSE_J),
        numbers(sf, si, RADIUS),
    )
    masses = (
        indices(si, BLOCK_OF_FRAME, SYSTEM),
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
    """The column k of arrays of n numbers."""
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
def placed(f, k, n):
    """(x, R, reach) of the columns from k on, as of `DetectionPose`."""
    return vectors(f, k, n), rotations(f, k + 3, n), column(f, k + 12, n)


@kernel(inline="always")
def contacts(found, nc):
    """(names, points, scalars) of what was found, as `gather` gives them."""
    f, i = found
    return i[: 5 * nc].reshape((5, nc)), f[: 12 * nc].reshape((4, nc, 3)), f[12 * nc : 15 * nc].reshape((3, nc))


@kernel(inline="always")
def rows(found, nc):
    """(frame, block, start, H, scales, its size and whether they are made) of what was found."""
    f, i = found
    return (
        rotations(f, FRAMES, nc),
        i[BLOCKS * nc : STARTS * nc].reshape((nc, 2)),
        i[STARTS * nc : FOUND_NAMES * nc].reshape((nc, 2)),
        f[ROWS * nc :],
        column(f, SCALES, nc),
        i[FOUND_NAMES * nc :],
    )
