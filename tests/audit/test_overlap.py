"""True overlaps of described shapes: closed forms, an independent search, translations that part the shapes."""

import numpy as np
import pytest
from scipy.optimize import elementwise
from scipy.spatial.transform import Rotation

from nsdyn.audit import overlap as module
from nsdyn.audit.overlap import overlap, separation
from nsdyn.audit.true_shapes import SIZES, Solid
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
DEPTHS = np.array([1e-2, 1e-4, 1e-6, 1e-7, -1e-4])


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


def test_every_kind_of_shape_is_tried_and_has_as_many_sizes_as_the_audit_says():
    kinds = {name for name, _ in shapes.CURVED.values()} | {"halfspace", "box", "convex"}
    made = [GROUND, *SHAPES.values()]
    assert set(SIZES) == {shape.name for shape in made} == kinds
    assert not any(shape.size[SIZES[shape.name] :].any() for shape in made)


def test_edges_across():
    """Two cubes whose edges cross at right angles overlap by what the edges do."""
    cube, half = shapes.box((1.0, 1.0, 1.0)), 2.0**0.5
    first = Rotation.from_euler("x", 45, degrees=True).as_matrix()
    second = Rotation.from_euler("y", 45, degrees=True).as_matrix()
    for eps in (1e-2, 1e-7):
        assert depth(cube, cube, (0.1, 0.2, half - eps), second, first) == pytest.approx(eps, rel=1e-7)


def searched(a, b, R, x, rng):
    """Largest separations that a random search finds for poses R (m, 3, 3), x (m, 3), from three starts each."""

    def along(n):  # n (m, ..., 3)
        return n @ x[:, :, None] - (a.support(n) + b.support(-(n @ R)))[..., None]

    def best(n, count):
        """The directions of the largest separations, shape (m, count, 3), and these."""
        values = along(n)
        k = np.argsort(-values, axis=1)[:, :count]
        return np.take_along_axis(n, k, axis=1), np.take_along_axis(values, k, axis=1)

    n = np.tile(rng.normal(size=(1000, 3)), (len(x), 1, 1))
    n = np.concatenate([n / a.half, (n / b.half) @ R.transpose(0, 2, 1)], axis=1)
    at, value = best(n / np.linalg.norm(n, axis=2, keepdims=True), 3)
    at, value = at.reshape(-1, 1, 3), value.reshape(-1, 1, 1)
    R, x = np.repeat(R, 3, axis=0), np.repeat(x, 3, axis=0)
    reach = np.full_like(value, 0.1)
    while reach.max() > 1e-9:
        tried = at + reach * rng.normal(size=(len(at), 30, 3))
        tried, new = best(tried / np.linalg.norm(tried, axis=2, keepdims=True), 1)
        better = new > value
        at, value = np.where(better, tried, at), np.where(better, new, value)
        reach = np.where(better, reach, 0.6 * reach)
    return value.reshape(-1, 3).max(axis=1)


QUICK = {("sphere", "cylinder"), ("capsule", "ellipsoid"), *((a, a) for a in ("sphere", "capsule", "box", "convex"))}


@pytest.mark.parametrize(
    ("first", "second"),
    [pytest.param(a, b, marks=[] if (a, b) in QUICK else pytest.mark.slow) for a, b in PAIRS],
)
def test_random_search_finds_no_larger_separation(first, second):
    """In random poses that overlap by given fractions of the size, or nearly touch."""
    rng = np.random.default_rng(1)
    a, b = (Solid.described(SHAPES[name].describe()) for name in (first, second))
    m, size = len(DEPTHS), min(a.extent, b.extent)
    R1, R2 = (Rotation.random(m, rng).as_matrix() for _ in range(2))
    x1, way = rng.normal(size=(2, m, 3))
    way /= np.linalg.norm(way, axis=1)[:, None]

    def excess(far, k):
        k = k.astype(int)
        return separation(a, R1[k], x1[k], b, R2[k], x1[k] + far[:, None] * way[k], exact=True) / size + DEPTHS[k]

    ends = np.full(m, 1e-3 * size), np.full(m, a.bounding_radius + b.bounding_radius + size)
    x2 = x1 + elementwise.find_root(excess, ends, args=(np.arange(m),)).x[:, None] * way
    found = separation(a, R1, x1, b, R2, x2, exact=True)
    # Of either one first, and of both together far from the origin.
    np.testing.assert_allclose(separation(b, R2, x2, a, R1, x1, exact=True), found, rtol=0.0, atol=1e-8 * size)
    np.testing.assert_allclose(found[:-1], -DEPTHS[:-1] * size, rtol=1e-6, atol=1e-8 * size)
    back = R1.transpose(0, 2, 1)
    assert (found >= searched(a, b, back @ R2, (back @ (x2 - x1)[:, :, None])[..., 0], rng) - 1e-8 * size).all()


def test_an_edge_of_a_cone_that_meets_an_ellipsoid():
    """Of the edges that meet in its tip more than six may be nearer to a direction than the one that separates best."""
    around = 2.0 * np.pi * np.arange(16) / 16
    rim = np.column_stack((0.039 * np.cos(around), 0.039 * np.sin(around), np.zeros(16)))
    cone = Solid.described(shapes.convex(np.vstack((rim, (0.0, 0.0, 0.098))))[0].describe())
    egg = Solid.described(shapes.ellipsoid((0.056, 0.0565, 0.0453)).describe())
    there, turn = np.array((-0.004466, -0.070789, 0.047888)), Rotation.from_rotvec((0.755228, 0.004882, -1.262003))
    world = Rotation.random(200, random_state=0)
    spun = world * turn * Rotation.from_rotvec(np.outer(around[np.arange(200) % 16], (0.0, 0.0, 1.0)))
    R1, R2, x = world.as_matrix(), spun.as_matrix(), world.apply(there)
    out = separation(egg, R1, np.zeros((200, 3)), cone, R2, x, exact=True)
    np.testing.assert_allclose(out, out.max(), rtol=0, atol=1e-9)  # one pose; 8e-6 along other edges


def test_poses_in_one_call():
    """Pairs one by one, one pose against many."""
    rng = np.random.default_rng(0)
    box, ball = SHAPES["box"].describe(), SHAPES["sphere"].describe()
    poses = np.array([pose(x) for x in 0.1 * rng.normal(size=(20, 3))])
    found = overlap(box, np.eye(4), ball, poses)
    assert found.shape == (20,)
    assert found.tolist() == [overlap(box, np.eye(4), ball, one) for one in poses]


def test_hulls_of_many_faces_need_all_corners_along_few_axes(monkeypatch):
    """As exact as all corners along all cross products of edges, of which few can beat the best."""
    rng = np.random.default_rng(5)
    points = rng.normal(size=(2, 300, 3))
    points *= 0.1 / np.linalg.norm(points, axis=2, keepdims=True)
    a, b = (Solid.described(shapes.convex(corners)[0].describe()) for corners in points)
    turn, x = Rotation.random(random_state=1).as_matrix(), np.array((0.15, 0.1, 0.07))
    here, there, edges = a.corners, b.corners @ turn.T + x, b.edges @ turn.T
    best, whole, along = -np.inf, [], module._along

    def counted(one, other, R, x, n):
        whole.append(n.shape[1] if len(one.corners) == len(here) else 0)
        return along(one, other, R, x, n)

    for n in (a.normals, b.normals @ turn.T, *(np.cross(edge, edges) for edge in a.edges)):
        length = np.linalg.norm(n, axis=1)
        n = n[length > 1e-12] / length[length > 1e-12, None]
        first, second = here @ n.T, there @ n.T
        best = max(best, *(second.min(axis=0) - first.max(axis=0)), *(first.min(axis=0) - second.max(axis=0)))
    monkeypatch.setattr(module, "_along", counted)
    found = separation(a, I[None], np.zeros((1, 3)), b, turn[None], x[None], exact=True)[0]
    assert abs(found - best) < 1e-15  # m, round-off of lengths of 0.1 m
    assert (
        0 < sum(whole) < 0.05 * len(a.edges) * len(b.edges)
    )  # a fiftieth of the pairs of edges; all without the bound


def test_unknown_shape():
    with pytest.raises(ValueError, match=r"Shape\.describe names, got 'teapot'"):
        overlap({"shape": "teapot", "size": [1, 1, 1]}, np.eye(4), SHAPES["box"].describe(), np.eye(4))


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("other", ["sphere", "capsule", "cylinder", "ellipsoid"])
@pytest.mark.parametrize("shape", ["sphere", "capsule", "cylinder", "ellipsoid"])
def test_shapes_about_one_centre_overlap_by_their_least_widths(shape, other):
    """All are 0.1 m about the axis that is the shortest of each: no line of centres says where to."""
    size, pose = (0.1, 0.2, 0.3), np.eye(4)
    depth = overlap({"shape": shape, "size": size}, pose, {"shape": other, "size": size}, pose)
    assert depth == pytest.approx(0.2, rel=1e-9)
