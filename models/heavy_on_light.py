"""Heavy cube on light ones: the mass ratio ruins iterative solvers, not the physics."""

from nsdyn import Material, Scene

DURATION, DT = 1.0, 1e-2


def scene(ratio: float = 1000.0, below: int = 1, size: float = 0.2, mass: float = 1.0, mu: float = 0.5) -> Scene:
    """A cube of `ratio` times `mass` [kg] on `below` cubes of `mass`, all of edge `size` [m]."""
    out = Scene(name="heavy_on_light")
    material = Material(mu=mu)
    out.add_halfspace("ground", material=material)
    for k in range(below):
        out.add_box(f"light{k}", (size, size, size), mass, position=(0, 0, (k + 0.5) * size), material=material)
    out.add_box("heavy", (size, size, size), ratio * mass, position=(0, 0, (below + 0.5) * size), material=material)
    return out
