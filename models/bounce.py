"""Ball dropped on the ground: apex n is e^(2 n) times the first height."""

from nsdyn import Material, Scene

DURATION, DT = 3.0, 1e-3


def scene(
    height: float = 1.0, restitution: float = 0.8, radius: float = 0.1, mass: float = 1.0, mu: float = 0.5
) -> Scene:
    """Ball of `radius` [m] and `mass` [kg] whose lowest point starts `height` [m] above the ground."""
    out = Scene(name="bounce")
    material = Material(mu=mu, restitution=restitution)
    out.add_halfspace("ground", material=material)
    out.add_sphere("ball", radius, mass, position=(0, 0, radius + height), material=material)
    return out
