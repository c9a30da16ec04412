"""Ball dropped on the ground: apex n is e^(2 n) times the first height, and all bounces end at a finite time.

At t = sqrt(2 H/g) (1 + e)/(1 - e) the ball lies still. With speed and spin each impact slips or grips: it grips, with
v' = (5 v + 2 r w)/7, if mu (1 + e) |v_n| >= 2/7 |v - r w|.
"""

from nsdyn import Material, Scene

DURATION, DT = 3.0, 1e-3


def scene(
    height: float = 1.0,
    restitution: float = 0.8,
    radius: float = 0.1,
    mass: float = 1.0,
    mu: float = 0.5,
    speed: float = 0.0,
    fall: float = 0.0,
    spin: float = 0.0,
    gravity: float = 9.81,
) -> Scene:
    """Ball of `radius` [m] and `mass` [kg] whose lowest point starts `height` [m] above the ground.

    It starts with `speed` along x, `fall` downwards [m/s] and `spin` about y [rad/s].
    """
    out = Scene(gravity=(0, 0, -gravity), name="bounce")
    material = Material(mu=mu, restitution=restitution)
    out.add_halfspace("ground", material=material)
    out.add_sphere(
        "ball",
        radius,
        mass,
        position=(0, 0, radius + height),
        material=material,
        linear_velocity=(speed, 0, -fall),
        angular_velocity=(0, spin, 0),
    )
    return out
