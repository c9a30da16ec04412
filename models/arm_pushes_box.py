"""Two-link arm that swings into a cube and pushes it over the ground."""

from pathlib import Path

from nsdyn import Material, Scene

DURATION, DT = 1.0, 2e-3


def scene(swing: float = 2.0, mass: float = 1.0, size: float = 0.2, mu: float = 0.4) -> Scene:
    """Arm turning at `swing` [rad/s] at the shoulder, cube of edge `size` [m] and `mass` [kg] in its way."""
    out = Scene(name="arm_pushes_box")
    material = Material(mu=mu)
    out.add_halfspace("ground", material=material)
    out.add_urdf(
        "arm",
        Path(__file__).with_name("arm.urdf"),
        position=(0, 0, 0),
        q=(-0.6, 0.3),
        v=(swing, 0.0),
        material=material,
    )
    out.add_box("box", (size, size, size), mass, position=(0.75, 0.15, size / 2), material=material)
    return out
