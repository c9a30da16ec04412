"""Tower of equal cubes at rest: nothing may move, and box k carries the weight of those above."""

from nsdyn import Material, Scene

DURATION, DT = 1.0, 1e-2


def scene(height: int = 10, size: float = 0.2, mass: float = 1.0, mu: float = 0.5) -> Scene:
    """`height` cubes of edge `size` [m] and `mass` [kg] on top of each other."""
    out = Scene(name="stack")
    material = Material(mu=mu)
    out.add_halfspace("ground", material=material)
    for k in range(height):
        out.add_box(f"box{k}", (size, size, size), mass, position=(0, 0, (k + 0.5) * size), material=material)
    return out
