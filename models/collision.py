"""Two spinning balls meet off centre, with friction: momentum and angular momentum stay what they were."""

from nsdyn import Material, Scene

DURATION, DT = 0.4, 1e-3


def scene(
    mu: float = 0.3, restitution: float = 0.6, speed: float = 3.0, spin: tuple[float, float, float] = (0.0, 5.0, 0.0),
    offset: tuple[float, float] = (0.0, 0.05), radii: tuple[float, float] = (0.1, 0.15),
    masses: tuple[float, float] = (1.0, 2.5),
) -> Scene:  # fmt: skip
    """Ball a comes along x at `speed` [m/s] with `spin` [rad/s]; ball b waits `offset` [m] aside in y and z."""
    out = Scene(gravity=(0, 0, 0), name="collision")
    material = Material(mu=mu, restitution=restitution)
    out.add_sphere("a", radii[0], masses[0], linear_velocity=(speed, 0, 0), angular_velocity=spin, material=material)
    out.add_sphere("b", radii[1], masses[1], position=(0.5, *offset), material=material)
    return out
