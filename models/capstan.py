"""Rope over a bollard, turned inside out: blocks in a round trough between two weights, held by Coulomb's friction."""

import numpy as np

from nsdyn import Material, Scene

DURATION, DT = 1.0, 5e-3


def scene(
    blocks: int = 8,
    mu: float = 0.3,
    ratio: float = 2.6,
    weight: float = 10.0,
    block_mass: float = 1e-2,
    radius: float = 1.0,
    thickness: float = 0.2,
    width: float = 0.2,
) -> Scene:
    """`blocks` wedges of `block_mass` [kg] on the flat facets of half a circle of `radius` [m] below the ground.

    They touch each other without friction and the trough with `mu`; on the left end stands `weight` [kg], on the right
    `ratio` times that. Every block lets the thrust grow by (cos(d/2) + mu sin(d/2))/(cos(d/2) - mu sin(d/2)) at most,
    d = pi/blocks, so that without weights of the blocks it stands up to that to the power `blocks`: 2.60105 for 8
    blocks and mu = 0.3, towards exp(mu pi) = 2.56633 for many (Euler, Eytelwein).
    """
    out = Scene(name="capstan")
    smooth, rough = Material(mu=0.0), Material(mu=mu)
    d = np.pi / blocks
    half = radius * np.tan(d / 2)
    joints = np.pi + d * np.arange(blocks + 1)
    for k in range(blocks):
        middle = joints[k] + d / 2
        outward = np.array([np.cos(middle), 0, np.sin(middle)])
        # The body axis z of a facet points outwards. It ends short of its neighbours' blocks.
        turn = (np.pi / 2 - middle) / 2
        out.add_box(
            f"facet{k}",
            (1.8 * half, 2 * width, 0.1),
            fixed=True,
            material=rough,
            position=(radius + 0.05) * outward,
            quaternion=(0, np.sin(turn), 0, np.cos(turn)),
        )
        corners = [
            (r / np.cos(d / 2) * np.cos(a), y, r / np.cos(d / 2) * np.sin(a))
            for a in joints[k : k + 2]
            for r in (radius - thickness, radius)
            for y in (-width / 2, width / 2)
        ]
        out.add_convex(f"block{k}", corners, block_mass, material=rough)
        if k:
            out.set_pair(f"block{k - 1}", f"block{k}", mu=0.0)
    for name, side, mass in (("left", -1.0, weight), ("right", 1.0, ratio * weight)):
        x = side * (radius - thickness / 2) / np.cos(d / 2)
        out.add_box(name, (thickness, width, thickness), mass, position=(x, 0, thickness / 2), material=smooth)
    return out
