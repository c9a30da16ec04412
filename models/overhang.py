"""Books stacked over the edge of a table with the largest overhang: the harmonic series."""

from nsdyn import Material, Scene

DURATION, DT = 2.0, 5e-3


def scene(
    books: int = 4,
    excess: float = -1e-3,
    length: float = 0.2,
    thickness: float = 0.03,
    width: float = 0.15,
    mass: float = 0.5,
    mu: float = 0.5,
) -> Scene:
    """`books` books of `length` x `width` x `thickness` [m] and `mass` [kg] on a table that ends at x = 0.

    The k-th from the top juts out over the next one by (1 + `excess`) `length`/(2 k): then the centre of mass of the k
    on top lies (1 + `excess`) half a length from the middle of the next one. They stand for `excess` < 0 and topple for
    `excess` > 0, all edges at once.
    """
    out = Scene(name="overhang")
    material = Material(mu=mu)
    out.add_box(
        "table",
        (3 * length, 2 * width, length),
        fixed=True,
        position=(-1.5 * length, 0, -length / 2),
        material=material,
    )
    x = -length / 2
    for k in range(books, 0, -1):
        x += (1.0 + excess) * length / (2 * k)
        out.add_box(
            f"book{k}",
            (length, width, thickness),
            mass,
            material=material,
            position=(x, 0, (books - k + 0.5) * thickness),
        )
    return out
