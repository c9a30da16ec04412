"""The works of a move in one call."""

from nsdyn._kernels.compiled import in_place
from nsdyn._kernels.dynamics.motion import beyond_potential
from nsdyn._kernels.stepping.law import outcome


@in_place
def account(bodies, move, velocities, rows, r, lasting, slow, out):
    """`beyond_potential` of bodies = (mass, gravity) in a move = (h, theta), and `outcome`.

    With forces for the impulses in world axes.
    """
    beyond = beyond_potential(*bodies, *move, *velocities)
    normal, friction, rest = outcome(rows, velocities[2], r, lasting, slow, out)
    h, _ = move
    world = out[4]
    for c in range(world.shape[0]):
        for i in range(3):
            world[c, i] /= h
    return beyond, normal, friction, rest
