"""Block rocking on its edges after Housner: each landing keeps 1 - 3/2 sin²(alpha) of the turning speed.

alpha = atan(width/height), p² = 3 g/(4 R), R half the diagonal. Let go at a tilt theta, a slender block needs
acosh(1/(1 - theta/alpha))/p to land, a quarter of a period.

G. W. Housner, The behavior of inverted pendulum structures during earthquakes, Bull. Seism. Soc. Am. 53, 1963.
"""

import math

from nsdyn import Material, Scene

DURATION, DT = 2.0, 1e-3


def scene(
    tilt: float = 5.0,
    spin: float = 0.0,
    width: float = 0.25,
    height: float = 1.0,
    depth: float = 0.5,
    mass: float = 100.0,
    mu: float = 2.0,
) -> Scene:
    """Block of `width` x `depth` x `height` [m] and `mass` [kg] on its right edge at `tilt` [deg].

    It turns about that edge at `spin` [rad/s], positive where the tilt grows.
    """
    out = Scene(name="rocking")
    material = Material(mu=mu)
    out.add_halfspace("ground", material=material)
    t = math.radians(tilt)
    # The centre seen from the right edge, turned by t about y.
    x = -width / 2 * math.cos(t) + height / 2 * math.sin(t)
    z = width / 2 * math.sin(t) + height / 2 * math.cos(t)
    out.add_box(
        "block",
        (width, depth, height),
        mass,
        material=material,
        quaternion=(0, math.sin(t / 2), 0, math.cos(t / 2)),
        position=(width / 2 + x, 0, z),
        angular_velocity=(0, spin, 0),
        linear_velocity=(spin * z, 0, -spin * x),
    )
    return out
