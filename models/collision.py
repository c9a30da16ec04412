"""Two spinning balls meet off centre, with friction: momentum and angular momentum stay what they were."""

from nsdyn import Material, Scene

DURATION, DT = 0.4, 1e-3


def scene(
    mu: float = 0.3,
    restitution: float = 0.6,
    speed: float = 3.0,
    spin_x: float = 0.0,
    spin_y: float = 5.0,
    spin_z: float = 0.0,
    offset_y: float = 0.0,
    offset_z: float = 0.05,
    radius: float = 0.1,
    mass: float = 1.0,
) -> Scene:
    """Ball a of `radius` [m] and `mass` [kg] comes along x at `speed` [m/s] with `spin` [rad/s].

    Ball b, 1.5 times as large and 2.5 times as heavy, waits 5 radii ahead and `offset` [m] aside.
    """
    out = Scene(gravity=(0, 0, 0), name="collision")
    material = Material(mu=mu, restitution=restitution)
    out.add_sphere(
        "a", radius, mass, linear_velocity=(speed, 0, 0), angular_velocity=(spin_x, spin_y, spin_z), material=material
    )
    out.add_sphere("b", 1.5 * radius, 2.5 * mass, position=(5 * radius, offset_y, offset_z), material=material)
    return out
