"""Ball at 100 m/s against a wall of 10 mm: it flies a hundred walls in a step and is stopped by the first."""

from nsdyn import Material, Scene

DURATION, DT = 0.2, 1e-2


def scene(
    speed: float = 100.0,
    shift: float = 0.0,
    restitution: float = 0.0,
    wall: float = 0.01,
    radius: float = 0.02,
    mass: float = 1.0,
) -> Scene:
    """Ball of `radius` [m] and `mass` [kg] flying at `speed` [m/s] at a `wall` [m] thick, 5 m + `shift` away."""
    out = Scene(gravity=(0, 0, 0), name="bullet")
    material = Material(0.0, restitution)
    out.add_box("wall", (wall, 2, 2), fixed=True, position=(5 + shift, 0, 0), material=material)
    out.add_sphere("ball", radius, mass, linear_velocity=(speed, 0, 0), material=material)
    return out
