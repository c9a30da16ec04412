"""Ball thrown without spin: it slides for 2 v0/(7 mu g), then rolls at 5/7 v0."""

from nsdyn import Material, Scene

DURATION, DT = 1.0, 1e-2


def scene(speed: float = 2.0, spin: float = 0.0, mu: float = 0.3, radius: float = 0.1, mass: float = 1.0) -> Scene:
    """Ball of `radius` [m] and `mass` [kg] at `speed` [m/s] along x with `spin` [rad/s] about y."""
    out = Scene(name="roll")
    material = Material(mu=mu)
    out.add_halfspace("ground", material=material)
    out.add_sphere(
        "ball",
        radius,
        mass,
        position=(0, 0, radius),
        material=material,
        linear_velocity=(speed, 0, 0),
        angular_velocity=(0, spin, 0),
    )
    return out
