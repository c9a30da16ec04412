"""Free body turning about its middle axis of inertia, slightly off it: it flips over again and again."""

import numpy as np

from nsdyn import Scene

DURATION, DT = 80.0, 1e-2


def scene(wobble: float = 0.01) -> Scene:
    """Body with principal moments 1, 2, 3 kg m² at (`wobble`, 1, `wobble`) [rad/s] in empty space.

    Energy and angular momentum stay; for a wobble of 0.01 it comes round in 39.105734 s (Euler's elliptic functions).
    """
    out = Scene(gravity=(0, 0, 0), name="intermediate_axis")
    # Edges of a nearly flat homogeneous box of 1 kg with these moments.
    size = np.sqrt([24.0, 12.0, 0.01])
    out.add_box("body", size, 1.0, inertia=np.diag([1.0, 2.0, 3.0]), angular_velocity=(wobble, 1.0, wobble))
    return out
