"""Semicircular arch of voussoirs with radial joints, standing on the ground."""

import numpy as np

from nsdyn import Material, Scene

DURATION, DT = 2.0, 5e-3


def scene(
    voussoirs: int = 11,
    thickness: float = 0.107,
    radius: float = 1.0,
    width: float = 0.3,
    density: float = 2000.0,
    mu: float = 0.6,
) -> Scene:
    """`voussoirs` equal wedges between `radius` ± `thickness`/2 [m], `width` [m] deep.

    It stands if thickness/radius exceeds the limit of Milankovitch's problem for that number of voussoirs with flat
    faces (0.10459 for 11, 0.1075 for a continuous arch) and friction holds the joints (mu above 0.4 or so).
    """
    out = Scene(name="arch")
    material = Material(mu=mu)
    out.add_halfspace("ground", material=material)
    inner, outer = radius - thickness / 2, radius + thickness / 2
    joints = np.linspace(np.pi, 0.0, voussoirs + 1)
    for k in range(voussoirs):
        section = [(r * np.cos(a), r * np.sin(a)) for a in joints[k : k + 2] for r in (inner, outer)]
        vertices = np.array([(x, y, z) for x, z in section for y in (-width / 2, width / 2)])
        (x0, z0), (x1, z1), (x2, z2), (x3, z3) = section[0], section[1], section[3], section[2]
        area = 0.5 * abs((x2 - x0) * (z3 - z1) - (x3 - x1) * (z2 - z0))
        out.add_convex(f"voussoir{k}", vertices, density * area * width, material=material)
    return out
