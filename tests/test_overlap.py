"""True overlaps of described shapes: closed forms, an independent search, translations that part the shapes."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from nsdyn.recording.overlap import Solid, overlap, separation
from nsdyn.scene import shapes

SHAPES = {
    "box": shapes.box((0.1, 0.2, 0.3)),
    "convex": shapes.convex(np.random.default_rng(3).normal(size=(12, 3)) * 0.1)[0],
    "sphere": shapes.sphere(0.1),
    "capsule": shapes.capsule(0.05, 0.2),
    "cylinder": shapes.cylinder(0.1, 0.15),
    "disc": shapes.cylinder(0.3, 0.02),
    "ellipsoid": shapes.ellipsoid((0.1, 0.2, 0.05)),
    "needle": shapes.ellipsoid((0.02, 0.02, 0.3)),
}
GROUND = shapes.halfspace((0.0, 0.0, 1.0), 0.5)
PAIRS = [(a, b) for k, a in enumerate(SHAPES) for b in list(SHAPES)[k:]]
DEPTHS = [1e-2, 1e-4, 1e-6, 1e-7, -1e-4]


I = np.eye(3)


def pose(x=(0, 0, 0), R=I):
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = R, x
    return out


def depth(a, b, x, R=I, R_ground=I):
    return overlap(a.describe(), pose((0, 0, 0), R_ground), b.describe(), pose(x, R))


TURN = Rotation.from_euler("z", 45, degrees=True).as_matrix()
LYING = Rotation.from_euler("x", 90, degrees=True).as_matrix()


@pytest.mark.parametrize("eps", [1e-3, 1e-6, 1e-8, 0.0])
@pytest.mark.parametrize(
    ("a", "b", "x", "R"),
    [
        ("box", "box", (0.0, 0.0, 0.3), np.eye(3)),
        ("box", "box", (0.02, 0.03, 0.3), TURN),
        ("box", "sphere", (0.0, 0.0, 0.25), np.eye(3)),
        ("box", "capsule", (0.0, 0.0, 0.2), LYING),
        ("box", "cylinder", (0.0, 0.0, 0.225), TURN),
        ("box", "cylinder", (0.0, 0.0, 0.25), LYING),
        ("box", "ellipsoid", (0.0, 0.0, 0.2), TURN),
        ("sphere", "sphere", (0.0, 0.0, 0.2), np.eye(3)),
        ("sphere", "capsule", (0.0, 0.0, 0.15), LYING),
        ("capsule", "capsule", (0.0, 0.0, 0.2), LYING),
        ("cylinder", "cylinder", (0.05, 0.0, 0.15), TURN),
        ("cylinder", "sphere", (0.0, 0.0, 0.175), np.eye(3)),
        ("disc", "needle", (0.0, 0.0, 0.31), np.eye(3)),
        ("ellipsoid", "needle", (0.0, 0.0, 0.07), LYING),
    ],
)
def test_closed_forms(a, b, x, R, eps):
    """The upper one sinks in by eps along z, its least way out."""
    assert depth(SHAPES[a], SHAPES[b], np.subtract(x, (0, 0, eps)), R) == pytest.approx(eps, abs=1e-13 + 1e-8 * eps)
    assert depth(SHAPES[a], SHAPES[b], np.add(x, (0, 0, max(eps, 1e-12))), R) == 0.0


@pytest.mark.parametrize("name", SHAPES)
def test_halfspace(name):
    """The lowest point is below the plane by the overlap, in any pose of both."""
    rng = np.random.default_rng(5)
    shape = SHAPES[name]
    for R, G in zip(Rotation.random(4, rng).as_matrix(), Rotation.random(4, rng).as_matrix(), strict=True):
        n = G[:, 2]
        low = Solid.described(shape.describe()).support(-(R.T @ n))
        x = (0.5 + low - 1e-7) * n + 10.0 * np.cross(n, (1.0, 2.0, 3.0))
        assert depth(GROUND, shape, x, R, G) == pytest.approx(1e-7, rel=1e-6)
    with pytest.raises(ValueError, match="two halfspaces"):
        depth(GROUND, GROUND, (0, 0, 0))


def test_edges_across():
    """Two cubes whose edges cross at right angles overlap by what the edges do."""
    cube, half = shapes.box((1.0, 1.0, 1.0)), 2.0**0.5
    first = Rotation.from_euler("x", 45, degrees=True).as_matrix()
    second = Rotation.from_euler("y", 45, degrees=True).as_matrix()
    for eps in (1e-2, 1e-7):
        assert depth(cube, cube, (0.1, 0.2, half - eps), second, first) == pytest.approx(eps, rel=1e-7)


def searched(a, b, R, x, rng):
    """Largest separation that a random search finds."""
    n = rng.normal(size=(1000, 3))
    n = np.vstack([n / a.half, (n / b.half) @ R.T])
    n /= np.linalg.norm(n, axis=1)[:, None]

    def along(n):
        return n @ x - a.support(n) - b.support(-(n @ R))

    values = along(n)
    out = -np.inf
    for k in np.argsort(-values)[:3]:
        at, value, reach = n[k], values[k], 0.1
        while reach > 1e-9:
            tried = at + reach * rng.normal(size=(30, 3))
            tried /= np.linalg.norm(tried, axis=1)[:, None]
            new = along(tried)
            if new.max() > value:
                at, value = tried[new.argmax()], new.max()
            else:
                reach *= 0.6
        out = max(out, value)
    return out


@pytest.mark.parametrize(("first", "second"), PAIRS)
def test_random_search_finds_no_larger_separation(first, second):
    """In random poses that overlap by given fractions of the size, or nearly touch."""
    rng = np.random.default_rng(1)
    a, b = (Solid.described(SHAPES[name].describe()) for name in (first, second))
    m, size = len(DEPTHS), min(a.extent, b.extent)
    R1, R2 = (Rotation.random(m, rng).as_matrix() for _ in range(2))
    x1, way = rng.normal(size=(2, m, 3))
    way /= np.linalg.norm(way, axis=1)[:, None]
    low, high = np.zeros(m), np.full(m, a.reach + b.reach)
    for _ in range(45):
        middle = 0.5 * (low + high)
        inside = separation(a, R1, x1, b, R2, x1 + middle[:, None] * way) < -np.array(DEPTHS) * size
        low, high = np.where(inside, middle, low), np.where(inside, high, middle)
    x2 = x1 + low[:, None] * way
    found = separation(a, R1, x1, b, R2, x2, exact=True)
    # Of either one first, and of both together far from the origin.
    np.testing.assert_allclose(separation(b, R2, x2, a, R1, x1, exact=True), found, rtol=0.0, atol=1e-8 * size)
    np.testing.assert_allclose(found[:-1], -np.array(DEPTHS[:-1]) * size, rtol=1e-6, atol=1e-8 * size)
    for k in range(m):
        more = searched(a, b, R1[k].T @ R2[k], R1[k].T @ (x2[k] - x1[k]), rng)
        assert found[k] >= more - 1e-8 * size


def test_poses_in_one_call():
    """Pairs one by one, one pose against many."""
    rng = np.random.default_rng(0)
    box, ball = SHAPES["box"].describe(), SHAPES["sphere"].describe()
    poses = np.array([pose(x) for x in 0.1 * rng.normal(size=(20, 3))])
    found = overlap(box, np.eye(4), ball, poses)
    assert found.shape == (20,)
    assert found.tolist() == [overlap(box, np.eye(4), ball, one) for one in poses]


def test_unknown_shape():
    with pytest.raises(ValueError, match=r"Shape\.describe names, got 'torus'"):
        overlap({"shape": "torus", "size": [1, 1, 1]}, np.eye(4), SHAPES["box"].describe(), np.eye(4))
