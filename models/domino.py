"""Row of dominoes, the first one pushed over."""

from nsdyn import Material, Scene

DURATION, DT = 2.0, 2e-3


def scene(
    count: int = 20,
    thickness: float = 0.0075,
    width: float = 0.022,
    height: float = 0.044,
    spacing: float = 0.022,
    mass: float = 0.01,
    push: float = 6.0,
    mu: float = 0.3,
) -> Scene:
    """`count` dominoes [m, kg] standing `spacing` [m] apart face to face; the first turns over at `push` [rad/s]."""
    out = Scene(name="domino")
    material = Material(mu=mu)
    out.add_halfspace("ground", material=material)
    for k in range(count):
        w = push if k == 0 else 0.0
        # Turning about its lower front edge: v = w x (centre - edge).
        out.add_box(
            f"domino{k}",
            (thickness, width, height),
            mass,
            material=material,
            position=(k * (spacing + thickness), 0, height / 2),
            angular_velocity=(0, w, 0),
            linear_velocity=(w * height / 2, 0, w * thickness / 2),
        )
    return out
