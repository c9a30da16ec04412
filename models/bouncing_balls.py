"""Square of elastic balls dropped on the ground: their energy stays what it was, bounce after bounce.

The bouncing benchmark of SimBenchmark (7 x 7 balls, 5 m, 20 s), whose measure is the energy.
"""

from nsdyn import Material, Scene

DURATION, DT = 2.0, 1e-2


def scene(
    rows: int = 7,
    height: float = 5.0,
    restitution: float = 1.0,
    radius: float = 0.5,
    mass: float = 10.0,
    spacing: float = 2.0,
) -> Scene:
    """`rows` x `rows` balls of `radius` [m] and `mass` [kg], `spacing` [m] apart, `height` [m] above the ground.

    Each starts a little higher than the one before, so that no two meet the ground together.
    """
    out = Scene(name="bouncing_balls")
    material = Material(mu=0.0, restitution=restitution)
    out.add_halfspace("ground", material=material)
    for k in range(rows**2):
        z = radius + height * (1.0 + 0.1 * k / rows**2)
        out.add_sphere(
            f"ball{k}", radius, mass, position=(spacing * (k // rows), spacing * (k % rows), z), material=material
        )
    return out
