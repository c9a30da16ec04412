"""Tower of 102 loose blocks, six storeys of posts and lintels: SimBenchmark's Kapla, which should stand for ever."""

from nsdyn import Material, Scene

DURATION, DT = 10.0, 1e-2


def scene(floors: int = 6, posts: int = 8, mass: float = 10.0, mu: float = 0.8) -> Scene:
    """`floors` storeys of `posts` upright blocks across and of lintels along both sides, every block of `mass` [kg].

    Lintels reach from the middle of one post to the middle of the next: alternately on the two sides, and at both ends
    on both. Nothing moves; solvers that leave errors in every step let it lean and fall after 50 to 6000 of them.

    J. Hwangbo, D. Kang et al., SimBenchmark, Kapla test.
    """
    out = Scene(name="kapla")
    material = Material(mu=mu)
    out.add_halfspace("ground", material=material)
    for i in range(floors):
        for j in range(posts):
            out.add_box(
                f"post{i}_{j}", (0.05, 0.25, 0.1), mass, position=(0.2 * j, 0, 0.2 * i + 0.05), material=material
            )
        right = [0.2 * j + 0.1 for j in range(0, posts, 2)]
        left = [0.1, *(0.2 * j + 0.1 for j in range(1, posts - 1, 2)), 0.2 * posts - 0.3]
        for side, y, middles in (("right", -0.1, right), ("left", 0.1, left)):
            for k, x in enumerate(middles):
                out.add_box(
                    f"{side}{i}_{k}", (0.2, 0.05, 0.1), mass, position=(x, y, 0.2 * i + 0.15), material=material
                )
    return out
