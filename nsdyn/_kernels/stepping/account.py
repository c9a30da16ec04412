"""The works of a move in one call."""

from nsdyn._kernels.compiled import in_place
from nsdyn._kernels.dynamics.motion import free_works
from nsdyn._kernels.stepping.law import outcome


@in_place
def account(
    blocks, bodies, loads, h, theta, velocities, r, mu, transport, lasting, struck, local, frame, slow, out
):  # fmt: skip
    """`free_works` of bodies = (mass, gravity) under loads = (force, torque), (external, beyond), then `outcome`.

    With forces for the impulses in world axes.
    """
    external, beyond = free_works(bodies[0], bodies[1], loads[0], loads[1], h, theta, *velocities)
    normal, friction, rest = outcome(blocks, velocities[2], transport, r, mu, lasting, struck, local, frame, slow, out)
    world = out[4]
    for c in range(world.shape[0]):
        for i in range(3):
            world[c, i] /= h
    return external, beyond, normal, friction, rest
