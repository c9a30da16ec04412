"""Shapes: mass properties against formulas, features of polytopes, meshes, misuse."""

import coal
import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial import ConvexHull

from nsdyn._kernels.collision import kinds
from nsdyn.scene import shapes
from nsdyn.scene.robot_files.model import from_coal

M = 2.5  # kg


@pytest.mark.parametrize(
    ("shape", "volume", "expected"),
    [
        (shapes.box((0.2, 0.4, 1.0)), 0.08, pin.Inertia.FromBox(M, 0.2, 0.4, 1.0).inertia),
        (shapes.sphere(0.3), 4 / 3 * np.pi * 0.027, pin.Inertia.FromSphere(M, 0.3).inertia),
        (shapes.cylinder(0.3, 0.8), np.pi * 0.09 * 0.8, pin.Inertia.FromCylinder(M, 0.3, 0.8).inertia),
        (
            shapes.capsule(0.3, 0.8),
            np.pi * 0.09 * 0.8 + 4 / 3 * np.pi * 0.027,
            pin.Inertia.FromCapsule(M, 0.3, 0.8).inertia,
        ),
        (
            shapes.ellipsoid((0.1, 0.2, 0.4)),
            4 / 3 * np.pi * 0.008,
            pin.Inertia.FromEllipsoid(M, 0.1, 0.2, 0.4).inertia,
        ),
    ],
    ids=["box", "sphere", "cylinder", "capsule", "ellipsoid"],
)
def test_mass_properties(shape, volume, expected):
    """Volume and inertia against the formula and Pinocchio; 1e-14 is a few roundings."""
    assert shape.volume == pytest.approx(volume, rel=1e-14)
    np.testing.assert_allclose(shape.inertia(M), expected, rtol=0, atol=1e-14)


def test_hull_has_the_mass_properties_of_the_same_box():
    """Also far from the origin, with points inside and on the faces; 1e-12 of what the offset of 100 m costs."""
    size = np.array([0.2, 0.4, 1.0])
    corners = np.array(list(np.ndindex(2, 2, 2))) * size
    inner = np.array([[0.1, 0.2, 0.5], [0.1, 0.2, 1.0], [0.1, 0.0, 1.0]])
    shape, centroid = shapes.convex(np.vstack((corners, inner)) + 100.0)
    np.testing.assert_allclose(centroid, 100.0 + size / 2, rtol=0, atol=1e-12)
    assert shape.volume == pytest.approx(0.08, rel=1e-12)
    np.testing.assert_allclose(shape.inertia(M), shapes.box(size).inertia(M), rtol=0, atol=1e-12)
    assert shape.vertices.shape == (8, 3)
    assert sorted(np.diff(shape.face_ptr)) == [4] * 6
    assert shape.inscribed_radius == pytest.approx(0.1, rel=1e-12)
    assert shape.bounding_radius == pytest.approx(np.linalg.norm(size) / 2, rel=1e-12)


@pytest.mark.parametrize("make", ["box", "cloud", "rounded"])
def test_faces_of_a_polytope(make, rng):
    """Loops are closed, planar, convex, anticlockwise from outside; every edge is shared by two faces."""
    if make == "box":
        shape = shapes.box((0.2, 0.4, 1.0))
    elif make == "cloud":
        shape, _ = shapes.convex(rng.normal(size=(60, 3)))
    else:  # a prism of 12 sides read from single precision, as meshes are
        angle = np.arange(12) * np.pi / 6
        ring = np.column_stack((np.cos(angle), np.sin(angle), np.ones(12)))
        shape, _ = shapes.convex(np.vstack((ring, ring * [1, 1, -1])).astype(np.float32))
        assert sorted(np.diff(shape.face_ptr)) == [4] * 12 + [12] * 2
    # 3e-7: single precision of the prism.
    assert (shape.vertices @ shape.face_normals.T - shape.face_offsets).max() < 3e-7
    np.testing.assert_allclose(np.linalg.norm(shape.face_normals, axis=1), 1.0, rtol=0, atol=1e-15)
    edges = []
    for f, (begin, end) in enumerate(zip(shape.face_ptr, shape.face_ptr[1:], strict=False)):
        loop = shape.face_loop[begin:end]
        edges += zip(loop.tolist(), np.roll(loop, -1).tolist(), strict=True)
        corners = shape.vertices[loop]
        assert np.abs(corners @ shape.face_normals[f] - shape.face_offsets[f]).max() < 3e-7
        a = np.roll(corners, -1, axis=0) - corners
        assert (np.cross(a, np.roll(a, -1, axis=0)) @ shape.face_normals[f] > 0).all()
    assert len(set(edges)) == len(edges)
    assert {(b, a) for a, b in edges} == set(edges)
    assert set(shape.face_loop.tolist()) == set(range(len(shape.vertices)))
    hull = ConvexHull(shape.vertices)
    assert shape.volume == pytest.approx(hull.volume, rel=1e-12)


def test_moments_of_a_tetrahedron():
    """A regular one: I = m a² / 20 for the edge a, about any axis through the centroid."""
    shape, centroid = shapes.convex([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    np.testing.assert_allclose(shape.inertia(1.0), np.eye(3) * 8 / 20, rtol=0, atol=1e-14)
    np.testing.assert_allclose(centroid, 0.0, rtol=0, atol=1e-15)
    assert shape.volume == pytest.approx(8 / 3, rel=1e-14)


def write_obj(path, vertices, triangles):
    lines = [f"v {x} {y} {z}" for x, y, z in vertices] + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in triangles]
    path.write_text("\n".join(lines) + "\n")
    return path


def prism(polygon):
    """Closed mesh of height 1 over a polygon that is star-shaped about its first corner (x, y)."""
    n = len(polygon)
    vertices = [(x, y, z) for z in (0.0, 1.0) for x, y in polygon]
    triangles = [(0, k + 1, k) for k in range(1, n - 1)] + [(n, n + k, n + k + 1) for k in range(1, n - 1)]
    for k in range(n):
        q = (k + 1) % n
        triangles += [(k, q, n + q), (k, n + q, n + k)]
    return vertices, triangles


def test_convex_mesh_is_read_without_warning(tmp_path):
    file = write_obj(tmp_path / "cube.obj", *prism([(0, 0), (1, 0), (1, 1), (0, 1)]))
    shape, centroid = shapes.mesh(file, scale=0.1)
    assert shape.volume == pytest.approx(1e-3, rel=1e-6)  # single precision of the reader
    np.testing.assert_allclose(centroid, 0.05, rtol=1e-6)
    assert len(shape.vertices) == 8


def test_hollow_mesh_warns(tmp_path):
    """An L of volume 3 in a hull of volume 3.5."""
    file = write_obj(tmp_path / "corner.obj", *prism([(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)]))
    with pytest.warns(UserWarning, match=r"not convex.*3\.5 m³, the mesh 3 m³"):
        shape, _ = shapes.mesh(file)
    assert shape.volume == pytest.approx(3.5, rel=1e-6)


@pytest.mark.parametrize(
    "shape",
    [
        shapes.halfspace((0, 1, 1), 0.3),
        shapes.box((1, 2, 3)),
        shapes.sphere(2),
        shapes.capsule(1, 2),
        shapes.cylinder(1, 2),
        shapes.ellipsoid((1, 2, 3)),
        shapes.convex(np.array(list(np.ndindex(2, 3, 4))) ** 1.0)[0],
    ],
    ids=["halfspace", "box", "sphere", "capsule", "cylinder", "ellipsoid", "convex"],
)
def test_round_trip_through_coal(shape):
    again, shift = from_coal(shape.geometry)
    assert again.kind == shape.kind
    np.testing.assert_allclose(again.size, shape.size, rtol=1e-15)
    np.testing.assert_allclose(shift, 0.0, rtol=0, atol=1e-15)
    np.testing.assert_allclose(again.vertices, shape.vertices, rtol=0, atol=1e-15)
    assert again.offset == pytest.approx(shape.offset, rel=1e-15)
    assert again.volume == pytest.approx(shape.volume, rel=1e-14)
    assert again.describe()["shape"] == shape.describe()["shape"]


def test_mesh_of_coal_becomes_its_hull(tmp_path):
    file = write_obj(tmp_path / "cube.obj", *prism([(0, 0), (1, 0), (1, 1), (0, 1)]))
    shape, shift = from_coal(coal.MeshLoader().load(str(file), np.ones(3)))
    assert shape.volume == pytest.approx(1.0, rel=1e-12)
    np.testing.assert_allclose(shift, 0.5, rtol=1e-12)


def test_unsupported_geometry():
    with pytest.raises(ValueError, match="Cone"):
        from_coal(coal.Cone(1.0, 2.0))


def test_describe_is_plain_data():
    out = shapes.convex(np.eye(4, 3))[0].describe()
    assert out["shape"] == "convex"
    assert len(out["vertices"]) == 4
    assert sorted(map(len, out["faces"])) == [3, 3, 3, 3]
    assert shapes.halfspace((0, 0, 2), 1.0).describe() == {"shape": "halfspace", "size": [0, 0, 1], "offset": 0.5}


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: shapes.sphere(0), "radius must be positive, got 0"),
        (lambda: shapes.sphere("big"), "radius must be a number, got 'big'"),
        (lambda: shapes.sphere(1e-300), "radius must be positive, at least 1e-50, got 1e-300"),
        (lambda: shapes.sphere(1e300), r"radius must be finite and at most 1e\+50 in size, got 1e\+300"),
        (lambda: shapes.capsule(1, -2), "length must be positive"),
        (lambda: shapes.cylinder(np.nan, 2), "radius must be finite, got nan"),
        (lambda: shapes.box((1, 2)), r"size must be 3 numbers, got shape \(2,\)"),
        (lambda: shapes.box((1, 2, 0)), "size must be positive"),
        (lambda: shapes.box((1, 2, 1e-300)), "size must be positive, at least 1e-50"),
        (lambda: shapes.ellipsoid((1, 2, -1)), "radii must be positive"),
        (lambda: shapes.halfspace((0, 0, 0), 1), "normal must not be zero"),
        (lambda: shapes.halfspace((0, 0, 1), np.inf), "offset must be finite"),
        (lambda: shapes.halfspace((0, 0, 1), 0).inertia(1.0), "no inertia"),
        (lambda: shapes.convex(np.zeros((3, 3))), r"shape \(n, 3\) with n ≥ 4, got \(3, 3\)"),
        (lambda: shapes.convex(np.eye(5)[:, :3] * [1, 1, 0]), "span a volume"),
        (lambda: shapes.convex(np.array(list(np.ndindex(2, 2, 2))) * [1, 1, 1e-7]), "span a volume.* 1e-07 m of one"),
        (lambda: shapes.convex(np.full((4, 3), np.nan)), "finite"),
        (lambda: shapes.mesh("nowhere.stl"), "path must be a mesh file, got 'nowhere.stl'"),
        (lambda: shapes.mesh("nowhere.stl", scale=0), "scale must be positive"),
    ],
)
def test_misuse(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_kernels_know_the_same_kinds():
    """Numbers of kinds stand twice, as a scene needs no kernels."""
    names = sorted(name for name, value in vars(shapes).items() if name.isupper() and isinstance(value, int))
    assert [getattr(kinds, name) for name in names] == [getattr(shapes, name) for name in names]
    assert sorted(getattr(shapes, name) for name in names) == list(range(len(names)))


def test_core_keeps_the_normals_and_lies_inside():
    """A core is thinner by the fraction of the inscribed radius on every side; a round shape is its own core."""
    cylinder, rounded = shapes.cylinder(0.3, 0.8), shapes.capsule(0.3, 0.8)
    core = cylinder.core(0.1)
    assert (core.radius, core.halfLength) == pytest.approx((0.27, 0.37), rel=1e-14)  # roundings
    assert (rounded.core(0.1).radius, rounded.core(0.1).halfLength) == (0.3, 0.4)
    np.testing.assert_allclose(shapes.box((0.2, 0.4, 1.0)).core(0.1).halfSide, (0.09, 0.19, 0.49), rtol=1e-14)
