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

    Odd rows are shifted by half a brick and close with half bricks at both ends.
    """
    out = Scene(name="wall")
    material = Material(mu=mu)
    out.add_halfspace("ground", material=material)
    pitch, half = length + joint, (length - joint) / 2
    for row in range(rows):
        if row % 2:
            bricks = [((half - length) / 2, half)]
            bricks += [((column + 0.5) * pitch, length) for column in range(columns - 1)]
            bricks += [((columns - 1) * pitch + (length - half) / 2, half)]
        else:
            bricks = [(column * pitch, length) for column in range(columns)]
        for k, (x, size) in enumerate(bricks):
            out.add_box(
                f"brick{row}_{k}",
                (size, width, height),
                density * size * width * height,
                position=(x, 0, (row + 0.5) * height),
                material=material,
            )
    return out
