"""Row of equal elastic balls, the first one thrown at the others.

Apart by a gap they pass their velocity on one by one and the last flies off with all of it; touching too, in rounds of
one instant. The laws of Poisson and Frémond take all contacts that touch at once: at e = 1 they send the first back at
(n - 2)/n of its speed and all others off together at 2/n; energy and momentum are kept, but real cradles do otherwise.
"""

from nsdyn import Material, Scene

DURATION, DT = 2.0, 1e-3


def scene(
    count: int = 5,
    gap: float = 0.01,
    speed: float = 1.0,
    restitution: float = 1.0,
    radius: float = 0.05,
    mass: float = 0.5,
) -> Scene:
    """`count` balls of `radius` [m] and `mass` [kg], `gap` [m] between them, without gravity.

    The first starts 0.1 m and `gap` away from the second at `speed` [m/s].
    """
    out = Scene(gravity=(0, 0, 0), name="cradle")
    material = Material(mu=0.0, restitution=restitution)
    for k in range(count):
        x = k * (2 * radius + gap) - (0.1 if k == 0 else 0.0)
        out.add_sphere(
            f"ball{k}",
            radius,
            mass,
            position=(x, 0, 0),
            material=material,
            linear_velocity=(speed if k == 0 else 0.0, 0, 0),
        )
    return out
