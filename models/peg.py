"""Peg squeezed between two walls that are a little too close: no position is right, and nothing may explode."""

from nsdyn import Material, Scene

DURATION, DT = 1.0, 1e-3


def scene(squeeze: float = 4e-8, mu: float = 0.5, size: float = 0.1, mass: float = 1.0) -> Scene:
    """Cube of edge `size` [m] and `mass` [kg] that overlaps a wall on either side by `squeeze` [m].

    A gap of either sign between -`squeeze` and `squeeze` is possible, none without overlap. Impulses that hold the cube
    up by friction exist, as large as one likes; so does the fall.
    """
    out = Scene(name="peg")
    material = Material(mu=mu)
    for name, side in (("left", -1.0), ("right", 1.0)):
        out.add_box(
            name, (size, 2 * size, 4 * size), fixed=True, position=(side * (size - squeeze), 0, 0), material=material
        )
    out.add_box("peg", (size, size, size), mass, position=(0, 0, 0), material=material)
    return out
