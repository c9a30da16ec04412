"""Brick wall in running bond: every brick lies on two, the ends of odd rows are half bricks."""

from nsdyn import Material, Scene

DURATION, DT = 2.0, 1e-2


def scene(
    rows: int = 10,
    columns: int = 10,
    length: float = 0.2,
    width: float = 0.1,
    height: float = 0.1,
    density: float = 2000.0,
    joint: float = 0.004,
    mu: float = 0.6,
) -> Scene:
    """`rows` rows of `columns` bricks of `length` x `width` x `height` [m], head joints open by `joint` [m].

    Rows are shifted by half a brick; a wall of 10 x 10 has 100 whole bricks.
    """
    out = Scene(name="wall")
    material = Material(mu=mu)
    out.add_halfspace("ground", material=material)
    pitch = length + joint
    for row in range(rows):
        for column in range(columns):
            x = (column + 0.5 * (row % 2)) * pitch
            out.add_box(
                f"brick{row}_{column}", (length, width, height), density * length * width * height,
                position=(x, 0, (row + 0.5) * height), material=material,
            )  # fmt: skip
    return out
