"""Contact points: exact where Coal's own are wrong, complete, continuous, reproducible."""

import functools
import subprocess
import sys

import coal
import numpy as np
import pinocchio as pin
import pytest

from nsdyn._kernels.collision import broadphase
from nsdyn.audit.true_shapes import Solid
from nsdyn.collision import distances
from nsdyn.collision.candidates import MARGIN, SKIN
from nsdyn.collision.contacts import ContactSet
from nsdyn.collision.detector import Detector
from nsdyn.scene import shapes
from nsdyn.scene.bodies import Geom
from nsdyn.scene.materials import Material
from nsdyn.scene.shapes import HALFSPACE

HEXAGON = np.array([[np.cos(a), np.sin(a), z] for a in np.arange(6) * np.pi / 3 for z in (-0.6, 0.6)]) * 0.5
BOX = shapes.box((1.0, 0.8, 0.6))
CYLINDER = shapes.cylinder(0.45, 0.6)
PRISM = shapes.convex(HEXAGON)[0]
FLAT = {"box": BOX, "cylinder": CYLINDER, "prism": PRISM}
"""Shapes with two flat ends at z = ±0.3."""

GROUND = shapes.halfspace((0, 0, 1), 0.0)
ALL = {
    **FLAT,
    "sphere": shapes.sphere(0.4),
    "capsule": shapes.capsule(0.3, 0.6),
    "ellipsoid": shapes.ellipsoid((0.2, 0.4, 0.5)),
}
UPRIGHT = np.eye(3)
LYING = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
TURNED = np.diag([1.0, -1.0, -1.0])


def about(axis, angle):
    return np.array(pin.exp3(angle * np.asarray(axis, dtype=float)))


def random_rotation(rng):
    q = rng.normal(size=4)
    return np.array(pin.Quaternion(q / np.linalg.norm(q)).toRotationMatrix())


def rule(i, j):
    """Friction and restitution that tell the pair."""
    return 0.1 * i + 0.01 * j, 0.001 * j


def detector(*what, excluded=(), max_points=8):
    """Detector of shapes; half-spaces are fixed, every other shape has its own frame."""
    geoms, frames = [], 0
    for k, shape in enumerate(what):
        fixed = shape.kind == HALFSPACE
        geoms.append(Geom(str(k), str(k), shape, -1 if fixed else frames, np.eye(3), np.zeros(3), Material()))
        frames += not fixed
    return Detector(geoms, rule, excluded, max_points)


def contacts_of(*placed, reach=0.0, **options):
    """Contacts of (shape, position, rotation) in one configuration."""
    moving = [p for p in placed if p[0].kind != HALFSPACE]
    x = np.array([p[1] for p in moving], dtype=float)
    R = np.array([p[2] for p in moving], dtype=float)
    return alone(detector(*(p[0] for p in placed), **options), x, R, np.full(len(moving), reach))


def alone(detector, x, R, reach):
    """Contacts of a configuration that continues no other."""
    return detector.find(x, R, reach, ContactSet.empty())


@functools.cache
def solid(shape):
    """The shape as the audit knows it."""
    return Solid.described(shape.describe())


def support(shape, R, n):
    """Point of a shape outermost along n, relative to its centre, by the audit's formulas."""
    return R @ solid(shape).curvature((R.T @ n)[None])[0][0]


# -- faces on faces ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("gap", [0.0, 1e-12, -1e-12, 1e-10, 1e-9, 1e-8, -1e-8, 1e-6, -1e-6, 1e-4, -1e-4, -5e-3])
@pytest.mark.parametrize("upper", FLAT)
@pytest.mark.parametrize("lower", FLAT)
def test_flat_ends_on_each_other(lower, upper, gap, rng):
    """At least 3 points with the exact normal and gap, at any gap, orientation, offset, either end up, either order.

    Coal loses points of an upright cylinder and everything near gap 0 (C1, C5, C8).
    """
    pair = detector(FLAT[lower], FLAT[upper])
    for k in range(12):
        Q, origin = random_rotation(rng), rng.normal(size=3)
        offset = rng.uniform(-0.3, 0.3, size=2) * (k % 3 != 0)
        R2 = Q @ about((0, 0, 1), rng.uniform(0, 6) * (k % 4 != 0)) @ (TURNED if k % 2 else UPRIGHT)
        x = np.array([origin, origin + Q @ [*offset, 0.6 + gap]])
        c = alone(pair, x, np.array([Q, R2]), np.zeros(2))
        assert 3 <= len(c.gap) <= 8
        # A few roundings of coordinates of size 3.
        assert np.abs(c.normal - Q[:, 2]).max() < 1e-14
        assert np.abs(c.gap - gap).max() < 2e-14
        assert area(c) > 0.05


def area(c):
    """Area of the hull of points around their mean, in the plane of the first normal."""
    e1 = np.cross(c.normal[0], [1.0, 0.0, 0.0] if abs(c.normal[0, 0]) < 0.9 else [0.0, 1.0, 0.0])
    e1 /= np.linalg.norm(e1)
    d = c.point - c.point.mean(axis=0)
    x, y = d @ e1, d @ np.cross(c.normal[0], e1)
    order = np.argsort(np.arctan2(y, x))
    x, y = x[order], y[order]
    return 0.5 * abs(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def test_aligned_boxes_touch_in_their_four_corners(rng):
    """No doubles from clipping a face by one that coincides with it."""
    for _ in range(20):
        Q, origin = random_rotation(rng), rng.normal(size=3)
        c = contacts_of((BOX, origin, Q), (BOX, origin + Q @ [0, 0, 0.6], Q))
        assert len(c.gap) == 4
        corners = (c.point - origin) @ Q
        np.testing.assert_allclose(np.abs(corners), np.tile([0.5, 0.4, 0.3], (4, 1)), rtol=0, atol=1e-14)


def test_every_corner_has_its_own_gap():
    """A box tilted by 0.05 degrees over a face and a plane; Coal gives all corners one depth (C3)."""
    R = about((0, 1, 0), np.deg2rad(0.05))
    cube = shapes.box((1.0, 1.0, 1.0))
    corners = cube.vertices @ R.T
    lift = 0.5 - 0.5 * (np.cos(np.deg2rad(0.05)) + np.sin(np.deg2rad(0.05)))
    for floor, top in ((GROUND, 0.0), (shapes.box((3.0, 3.0, 1.0)), 0.5)):
        z = top + 0.5 - lift
        c = contacts_of((floor, np.zeros(3), UPRIGHT), (cube, (0, 0, z), R), reach=1e-3)
        expected = np.sort(corners[corners[:, 2] < 0, 2] + z - top)
        assert expected[-1] - expected[0] > 8e-4
        np.testing.assert_allclose(np.sort(c.gap), expected, rtol=0, atol=1e-12)


def test_overhanging_box_is_cut_at_the_edge():
    c = contacts_of((shapes.box((1, 1, 1)), np.zeros(3), UPRIGHT), (shapes.box((1, 1, 1)), (0.3, 0.2, 1.0), UPRIGHT))
    expected = {(-0.2, -0.3), (-0.2, 0.5), (0.5, -0.3), (0.5, 0.5)}
    assert {(round(x, 12) + 0.0, round(y, 12) + 0.0) for x, y in c.point[:, :2]} == expected


@pytest.mark.parametrize("width", [1e-1, 1e-3, 1e-4])
@pytest.mark.parametrize("gap", [0.0, 1e-6, -1e-5])
def test_sliver_of_a_face(width, gap):
    """A box that rests on the last `width` of another one still rests on its face."""
    cube = shapes.box((1, 1, 1))
    c = contacts_of((cube, np.zeros(3), UPRIGHT), (cube, (1.0 - width, 0, 1.0 + gap), UPRIGHT))
    assert len(c.gap) == 4
    np.testing.assert_array_equal(c.normal, np.tile([0.0, 0.0, 1.0], (4, 1)))
    np.testing.assert_allclose(c.gap, gap, rtol=0, atol=1e-15)
    assert np.ptp(c.point[:, 0]) == pytest.approx(width, rel=1e-10)


def test_disk_under_a_box_is_cut_exactly():
    """Corners of the box inside the circle, its edges on the circle: all points lie in both."""
    c = contacts_of(
        (shapes.cylinder(0.6, 1.0), np.zeros(3), UPRIGHT), (shapes.box((1, 1, 1)), (0.1, 0.05, 1.0), UPRIGHT)
    )
    assert len(c.gap) == 8
    x, y, _ = c.point.T
    assert (np.hypot(x, y) < 0.6 + 1e-14).all()
    assert (np.maximum(np.abs(x - 0.1), np.abs(y - 0.05)) < 0.5 + 1e-14).all()
    np.testing.assert_allclose(c.gap, 0.0, rtol=0, atol=1e-15)


def test_small_box_inside_a_disk():
    c = contacts_of((shapes.cylinder(2.0, 1.0), np.zeros(3), UPRIGHT), (BOX, (0.1, 0, 0.8), UPRIGHT))
    np.testing.assert_allclose(
        sorted(map(tuple, c.point)),
        [(-0.4, -0.4, 0.5), (-0.4, 0.4, 0.5), (0.6, -0.4, 0.5), (0.6, 0.4, 0.5)],
        rtol=0,
        atol=1e-15,
    )


@pytest.mark.parametrize("tilt", [0.0, 1e-9, 1e-4, 0.3])
def test_cylinder_near_upright_on_a_plane(tilt):
    """The lowest rim point is found exactly, and the polygon turns about it."""
    R = about((np.cos(0.4), np.sin(0.4), 0), tilt)
    height = 0.3 * np.cos(tilt) + 0.45 * np.sin(tilt)
    c = contacts_of((GROUND, np.zeros(3), UPRIGHT), (CYLINDER, (0, 0, height), R), reach=1e-3)
    assert len(c.gap) == (8 if tilt < 1e-3 else 1)
    assert c.gap.min() == pytest.approx(0.0, abs=1e-9 if tilt == 1e-9 else 1e-15)
    assert np.hypot(*c.point[np.argmin(c.gap), :2]) > 0.3


# -- segments ----------------------------------------------------------------------------------------------


def test_crossing_capsules_touch_once(rng):
    """In the common perpendicular of their axes; Coal adds a second point far away in half of the cases (C2)."""
    for _ in range(200):
        Q, angle, gap = random_rotation(rng), rng.uniform(0.05, np.pi - 0.05), rng.uniform(-1e-3, 1e-3)
        s, r = rng.uniform(-0.29, 0.29, size=2)
        R1, R2 = Q @ LYING, Q @ about((0, 0, 1), angle) @ LYING
        x = -s * R1[:, 2], Q @ [0, 0, 0.3 + gap] - r * R2[:, 2]
        c = contacts_of((shapes.capsule(0.1, 0.6), x[0], R1), (shapes.capsule(0.2, 0.6), x[1], R2), reach=1e-3)
        # Where the axes are nearly parallel, the ends that the motion can close follow.
        assert len(c.gap) == 1 or abs(np.cos(angle)) > 0.8
        assert (c.gap[1:] > gap).all()
        assert c.gap[0] == pytest.approx(gap, abs=1e-14)
        np.testing.assert_allclose(c.normal[0], Q[:, 2], rtol=0, atol=1e-13)
        np.testing.assert_allclose(c.point[0], Q @ [0, 0, 0.1 + gap / 2], rtol=0, atol=1e-13)


@pytest.mark.parametrize("second", [shapes.capsule(0.2, 0.6), shapes.cylinder(0.2, 0.6)], ids=["capsule", "cylinder"])
@pytest.mark.parametrize("first", [shapes.capsule(0.2, 1.0), shapes.cylinder(0.2, 1.0)], ids=["capsule", "cylinder"])
def test_parallel_round_sides_touch_at_both_ends_of_the_overlap(first, second, rng):
    for _ in range(10):
        Q = random_rotation(rng)
        c = contacts_of((first, np.zeros(3), Q), (second, Q @ [0.4, 0, 0.4], Q))
        assert len(c.gap) == 2
        np.testing.assert_allclose(c.gap, 0.0, rtol=0, atol=1e-14)
        expected = np.array([[0.2, 0, 0.1], [0.2, 0, 0.5]]) @ Q.T
        np.testing.assert_allclose(c.point[np.argsort(c.point @ Q[:, 2])], expected, rtol=0, atol=1e-13)


@pytest.mark.parametrize("second", [shapes.capsule(0.15, 0.6), shapes.cylinder(0.15, 0.6)], ids=["capsule", "cylinder"])
def test_round_sides_that_are_almost_parallel_touch_with_their_ends(second, rng):
    """As the end of an axis and the other axis are apart, whichever body is first."""
    first, up = shapes.capsule(0.2, 1.0), np.array((0.0, 0.0, 1.0))
    for _ in range(40):
        along, axis = rng.uniform(-0.7, 0.7), rng.normal(size=3)
        R = about(axis / np.linalg.norm(axis), 10.0 ** rng.uniform(-6, -3.1))
        x = np.array((0.35, 0.0, along))
        c = contacts_of((first, np.zeros(3), UPRIGHT), (second, x, R), reach=1e-2)
        d = contacts_of((second, x, R), (first, np.zeros(3), UPRIGHT), reach=1e-2)
        np.testing.assert_allclose(d.normal, -c.normal, rtol=0, atol=1e-14)
        np.testing.assert_allclose(d.gap, c.gap, rtol=0, atol=1e-15)
        if second.kind == shapes.CAPSULE:
            ends = [(x + s * R @ up - np.clip(x[2] + s * R[2, 2], -0.5, 0.5) * up) for s in (-0.3, 0.3)]
            feet = [np.clip(R[:, 2] @ (s * up - x), -0.3, 0.3) * R[:, 2] + x - s * up for s in (-0.5, 0.5)]
            apart = min((np.linalg.norm(v), *v) for v in ends + feet)
            assert c.gap.min() == pytest.approx(apart[0] - 0.35, abs=1e-15)
            np.testing.assert_allclose(c.normal[c.gap.argmin()], np.array(apart[1:]) / apart[0], rtol=0, atol=1e-14)


@pytest.mark.parametrize("floor", [GROUND, shapes.box((0.8, 2, 1))], ids=["plane", "box"])
@pytest.mark.parametrize("shape", [shapes.capsule(0.2, 1.0), shapes.cylinder(0.2, 1.0)], ids=["capsule", "cylinder"])
def test_lying_round_sides_touch_twice_each_with_its_gap(shape, floor):
    """Ends at x = ±0.5, cut at ±0.4 by the box; one end higher by the tilt."""
    top, half = (0.0, 0.5) if floor is GROUND else (0.5, 0.4)
    tilt = 1e-4
    R = about((0, 1, 0), tilt) @ LYING
    c = contacts_of((floor, np.zeros(3), UPRIGHT), (shape, (0, 0, top + 0.2), R), reach=1e-3)
    assert len(c.gap) == 2
    order = np.argsort(c.point[:, 0])
    np.testing.assert_allclose(c.point[order, 0], [-half, half], rtol=0, atol=3e-5)  # 0.2 tan(tilt)
    # A cylinder's lowest line is at 0.2 cos(tilt), and cutting at the edge shifts the ends: tilt² times sizes.
    np.testing.assert_allclose(c.gap[order], [half * np.sin(tilt), -half * np.sin(tilt)], rtol=0, atol=3e-9)


@pytest.mark.parametrize("yaw", [-0.6, 0.6, np.pi / 2])
def test_crossing_edges_touch_once(yaw, rng):
    """Two boxes edge on edge, for either sign of the crossing angle (C2)."""
    cube = shapes.box((1, 1, 1))
    on_edge = about((1, 0, 0), np.pi / 4)
    for gap in (1e-4, 0.0, -1e-4):
        Q = random_rotation(rng)
        R2 = Q @ about((0, 0, 1), yaw) @ on_edge
        c = contacts_of((cube, np.zeros(3), Q @ on_edge), (cube, Q @ [0.1, 0.05, np.sqrt(2) + gap], R2))
        assert len(c.gap) == 1
        assert c.gap[0] == pytest.approx(gap, abs=1e-14)
        np.testing.assert_allclose(c.normal[0], Q[:, 2], rtol=0, atol=1e-14)
        # Where the lines y = 0 and y - 0.05 = tan(yaw) (x - 0.1) cross.
        np.testing.assert_allclose((c.point[0] @ Q)[:2], [0.1 - 0.05 / np.tan(yaw), 0.0], rtol=0, atol=1e-13)


def test_parallel_edges_touch_twice():
    cube = shapes.box((1, 1, 1))
    on_edge = about((1, 0, 0), np.pi / 4)
    c = contacts_of((cube, np.zeros(3), on_edge), (cube, (0.25, 0, np.sqrt(2)), on_edge))
    np.testing.assert_allclose(np.sort(c.point[:, 0]), [-0.25, 0.5], rtol=0, atol=1e-14)
    np.testing.assert_allclose(c.normal, np.tile([0.0, 0.0, 1.0], (2, 1)), rtol=0, atol=1e-5)  # Coal's direction
    np.testing.assert_allclose(c.gap, 0.0, rtol=0, atol=1e-10)


# -- one point ---------------------------------------------------------------------------------------------

GENERIC = [(a, b) for a in ALL for b in ALL if "ellipsoid" in (a, b) or "sphere" in (a, b) or "capsule" in (a, b)]


@pytest.mark.parametrize("gap", [0.0, 1e-9, 1e-6, -1e-6, -1e-4])
@pytest.mark.parametrize(("first", "second"), GENERIC, ids=["-".join(pair) for pair in GENERIC])
def test_smooth_contact_is_exact(first, second, gap, rng):
    """Two shapes placed support point to support point: one contact there, to round-off.

    Coal's own normal at gap 0 is wrong by more than 0.1 in nearly half of the cases with an ellipsoid.
    """
    A, B = ALL[first], ALL[second]
    pair = detector(A, B)
    for _ in range(12):
        R1, R2, n, o = random_rotation(rng), random_rotation(rng), rng.normal(size=3), rng.normal(size=3)
        n /= np.linalg.norm(n)
        p = o + support(A, R1, n)
        c = alone(pair, np.array([o, p + gap * n - support(B, R2, -n)]), np.array([R1, R2]), np.zeros(2))
        assert len(c.gap) == 1
        # Roundings of 1e-16 over the smallest radius of curvature, 0.08, of the ellipsoid and of Newton's last step.
        np.testing.assert_allclose(c.normal[0], n, rtol=0, atol=1e-12)
        np.testing.assert_allclose(c.point[0], p + gap / 2 * n, rtol=0, atol=abs(gap) / 2 + 1e-12)
        assert c.gap[0] == pytest.approx(gap, abs=1e-14)


def test_rims_of_cylinders(rng):
    """Rim against rim at a gap: the normal is the line between the points."""
    for _ in range(100):
        R1, R2, n = random_rotation(rng), random_rotation(rng), rng.normal(size=3)
        n /= np.linalg.norm(n)
        x = support(CYLINDER, R1, n) + 1e-3 * n - support(CYLINDER, R2, -n)
        c = contacts_of((CYLINDER, np.zeros(3), R1), (CYLINDER, x, R2), reach=1e-3)
        assert c.gap.min() == pytest.approx(1e-3, abs=1e-9)


def test_against_coal_for_separated_pairs(rng):
    """No gap is below the distance, and a single contact has it: Coal's is good to 1e-6 where shapes are apart."""
    request = coal.DistanceRequest()
    names = list(ALL)
    for _ in range(400):
        a, b = rng.choice(names, size=2)
        R1, R2 = random_rotation(rng), random_rotation(rng)
        direction = rng.normal(size=3)
        x = direction / np.linalg.norm(direction) * rng.uniform(0.9, 1.3)
        result = coal.DistanceResult()
        coal.distance(
            ALL[a].geometry, coal.Transform3s(), ALL[b].geometry, coal.Transform3s(R1.T @ R2, R1.T @ x), request, result
        )
        if result.min_distance < 0.01:
            continue
        c = contacts_of((ALL[a], np.zeros(3), R1), (ALL[b], x, R2), reach=1.0)
        assert c.gap.min() == pytest.approx(result.min_distance, abs=3e-6), (a, b)


# -- degenerate cases --------------------------------------------------------------------------------------


@pytest.mark.parametrize("second", ALL)
@pytest.mark.parametrize("first", ALL)
def test_concentric_shapes_have_a_unit_normal(first, second):
    """Also where Coal has none (C7, C9), for coincident axes, and the same one every time (C12)."""
    placed = (ALL[first], np.zeros(3), UPRIGHT), (ALL[second], np.zeros(3), UPRIGHT)
    c, again = contacts_of(*placed), contacts_of(*placed)
    assert len(c.gap) >= 1
    np.testing.assert_allclose(np.linalg.norm(c.normal, axis=1), 1.0, rtol=0, atol=1e-14)
    assert (c.gap < -0.2).all()
    assert np.isfinite(c.point).all()
    assert c.normal.tobytes() == again.normal.tobytes()


@pytest.mark.parametrize("depth", [0.01, 0.1, 0.25])
def test_deep_overlap_leaves_by_the_nearest_face(depth):
    c = contacts_of((shapes.box((3, 3, 1)), np.zeros(3), UPRIGHT), (BOX, (0.2, 0.3, 0.8 - depth), UPRIGHT))
    assert len(c.gap) == 4
    np.testing.assert_array_equal(c.normal, np.tile([0.0, 0.0, 1.0], (4, 1)))
    np.testing.assert_allclose(c.gap, -depth, rtol=0, atol=1e-15)


@pytest.mark.parametrize("length", [0.05, 0.3])
def test_a_capsule_is_found_however_deep_its_axis_is_in_a_box(length, rng):
    """Its depth is the least along normals of faces and of an edge and the axis, also past an edge."""
    rod = shapes.capsule(0.05, length)
    for _ in range(100):
        R, x = random_rotation(rng), rng.uniform(-0.5, 0.5, 3) * BOX.size
        normals = np.vstack((UPRIGHT, np.cross(UPRIGHT, R[:, 2])))
        normals /= np.linalg.norm(normals, axis=1)[:, None]
        apart = [n @ (x + support(rod, R, -n) - support(BOX, UPRIGHT, n)) for n in np.vstack((normals, -normals))]
        assert contacts_of((BOX, np.zeros(3), UPRIGHT), (rod, x, R)).gap.min() == pytest.approx(max(apart), abs=1e-9)


def test_pairs_that_are_never_tested():
    """Both fixed, half-spaces among themselves (C9), on one frame, excluded."""
    cube = shapes.box((1, 1, 1))

    def geom(shape, frame, t=(0.0, 0.0, 0.0)):
        return Geom("g", "g", shape, frame, np.eye(3), np.array(t), Material())

    fixed = [geom(GROUND, -1), geom(GROUND, -1), geom(cube, -1)]
    geoms = [*fixed, geom(cube, 0), geom(cube, 0, (0.9, 0.0, 0.0)), geom(cube, 1)]
    d = Detector(geoms, rule, {(5, 3)})
    c = alone(d, np.zeros((2, 3)), np.tile(np.eye(3), (2, 1, 1)), np.zeros(2))
    expected = {(0, 3), (0, 4), (0, 5), (1, 3), (1, 4), (1, 5), (2, 3), (2, 4), (2, 5), (4, 5)}
    assert set(zip(c.geom1.tolist(), c.geom2.tolist(), strict=True)) == expected
    assert {(-1, 0), (-1, 1), (0, 1)} == set(zip(c.frame1.tolist(), c.frame2.tolist(), strict=True))


def test_no_geoms_and_one_geom():
    assert alone(Detector([], rule), np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros(0)).gap.shape == (0,)
    assert len(contacts_of((BOX, np.zeros(3), UPRIGHT)).gap) == 0


def test_misuse():
    with pytest.raises(ValueError, match="max_points must be a whole number, at least 4, got 3"):
        detector(BOX, max_points=3)
    with pytest.raises(ValueError, match="max_points must be a whole number, at least 4, got 'many'"):
        detector(BOX, max_points="many")
    moving = Geom("slope", "slope", GROUND, 0, np.eye(3), np.zeros(3), Material())
    with pytest.raises(ValueError, match="halfspace 'slope' must be fixed"):
        Detector([moving], rule)


# -- sets of contacts --------------------------------------------------------------------------------------


DIRECTIONS = np.random.default_rng(1).normal(size=(60, 3))
# More than 32 corners: Coal climbs from corner to corner of such a polytope instead of trying all.
ROCK = shapes.convex(0.4 * DIRECTIONS / np.linalg.norm(DIRECTIONS, axis=1)[:, None])[0]
CROWD = [GROUND] + [*ALL.values(), ROCK] * 6


def pile(rng):
    """A crowd of shapes of all kinds over a plane: detector, x, R."""
    count = len(CROWD) - 1
    x = rng.uniform([-1.5, -1.5, 0.0], [1.5, 1.5, 2.5], size=(count, 3))
    return detector(*CROWD), x, np.array([random_rotation(rng) for _ in range(count)])


def rows(c):
    return [getattr(c, name) for name in ("geom1", "geom2", "point", "normal", "gap", "mu", "restitution")]


def test_order_materials_and_frames(rng):
    d, x, R = pile(rng)
    c = alone(d, x, R, np.zeros(len(x)))
    assert len(c.gap) > 100
    code = c.geom1 * 1000 + c.geom2
    assert (np.diff(code) >= 0).all()
    assert (c.geom1 < c.geom2).all()
    np.testing.assert_array_equal(c.frame1, c.geom1 - 1)
    np.testing.assert_array_equal(c.frame2, c.geom2 - 1)
    np.testing.assert_array_equal(c.mu, 0.1 * c.geom1 + 0.01 * c.geom2)
    np.testing.assert_array_equal(c.restitution, 0.001 * c.geom2)
    np.testing.assert_allclose(np.linalg.norm(c.normal, axis=1), 1.0, rtol=0, atol=1e-14)
    np.testing.assert_array_equal(np.sort(c.key), np.arange(len(c.key)))


def test_candidates_equal_brute_force(rng):
    """All pairs whose exact bounding boxes, inflated as documented, meet; nothing else may touch."""
    for _ in range(5):
        d, x, R = pile(rng)
        reach = rng.uniform(0, 0.05, size=len(x))
        alone(d, x, R, reach)
        n = len(CROWD)
        low, high = np.zeros((n, 3)), np.zeros((n, 3))
        for g in range(1, n):
            radius = CROWD[g].bounding_radius
            skin = MARGIN * radius + SKIN * radius + reach[g - 1]  # no list before to go by
            for k, e in enumerate(np.eye(3)):
                high[g, k] = x[g - 1, k] + e @ support(CROWD[g], R[g - 1], e) + skin
                low[g, k] = x[g - 1, k] + e @ support(CROWD[g], R[g - 1], -e) - skin
        expected = {(0, g) for g in range(1, n) if low[g, 2] <= 0.0}
        expected |= {
            (i, j)
            for i in range(1, n)
            for j in range(i + 1, n)
            if (low[i] <= high[j]).all() and (low[j] <= high[i]).all()
        }
        assert set(zip(*(p.tolist() for p in d.pairs), strict=True)) == expected


@pytest.mark.slow
def test_reused_candidates_give_the_contacts_of_fresh_ones(rng):
    """Bit for bit, while the list is renewed only now and then."""
    d, x, R = pile(rng)
    reach = np.full(len(x), 5e-3)
    velocity = rng.uniform(-1.0, 1.0, size=x.shape) * 5e-3 / np.sqrt(3.0)
    renewed, last = 0, None
    for _ in range(30):
        x = x + velocity
        c = alone(d, x, R, reach)
        fresh = detector(*CROWD)
        for a, b in zip(rows(c), rows(alone(fresh, x, R, reach)), strict=True):
            assert a.tobytes() == b.tobytes()
        renewed += d.pairs[0] is not last
        last = d.pairs[0]
    assert 2 <= renewed <= 10


@pytest.mark.slow
def test_swapped_bodies_mirror_the_contacts(rng):
    """Same points (moved along the normal by the gap at most), opposite normals, same gaps."""
    names = list(ALL)
    for _ in range(60):
        a, b = rng.choice(names, size=2)
        R1, R2, n = random_rotation(rng), random_rotation(rng), rng.normal(size=3)
        n /= np.linalg.norm(n)
        x = support(ALL[a], R1, n) + 1e-4 * n - support(ALL[b], R2, -n)
        one = contacts_of((ALL[a], np.zeros(3), R1), (ALL[b], x, R2))
        two = contacts_of((ALL[b], x, R2), (ALL[a], np.zeros(3), R1))
        assert len(one.gap) == len(two.gap)
        np.testing.assert_allclose(two.normal, -one.normal, rtol=0, atol=1e-8)
        np.testing.assert_allclose(two.gap, one.gap, rtol=0, atol=1e-10)
        np.testing.assert_allclose(two.point, one.point, rtol=0, atol=1e-4)


@pytest.mark.parametrize("unit", [2.0**-14, 2.0**14])
def test_contacts_are_the_same_in_any_unit_of_length(unit, rng):
    """To the last bit for powers of two, beside a body of another size: Coal has constants that are lengths."""

    def made(u):
        curved = (
            shapes.capsule(0.3 * u, 0.6 * u),
            shapes.cylinder(0.45 * u, 0.6 * u),
            shapes.ellipsoid((0.2 * u, 0.4 * u, 0.5 * u)),
        )
        return shapes.box((u, 0.8 * u, 0.6 * u)), shapes.convex(HEXAGON * u)[0], *curved

    metre, other, crumb, found = made(1.0), made(unit), shapes.box((2e-3, 1e-3, 1e-3)), 0
    for k in range(120):
        a, b = rng.choice(len(metre), size=2)
        tilt, gap, axis = 10.0 ** rng.uniform(-9, -3), rng.choice([-1e-6, 1e-6]), rng.normal(size=3)
        R1, R2 = (LYING, UPRIGHT)[k % 2], about(axis / np.linalg.norm(axis), tilt) @ (LYING, UPRIGHT)[k // 2 % 2]
        up = np.array((0.0, 0.0, 1.0))
        x = (support(metre[a], R1, up) - support(metre[b], R2, -up) + gap * up)[2] * up + [0.1, 0.05, 0.0]
        near = x - 0.4 * up + support(metre[b], R2, np.array((1.0, 0.0, 0.0)))
        c, d = (
            contacts_of((s[a], np.zeros(3), R1), (s[b], u * x, R2), (shape, u * near, R1))
            for s, u, shape in ((metre, 1.0, crumb), (other, unit, shapes.box(unit * np.array((2e-3, 1e-3, 1e-3)))))
        )
        np.testing.assert_array_equal(d.normal, c.normal)
        np.testing.assert_array_equal(d.point, unit * c.point)
        np.testing.assert_array_equal(d.gap, unit * c.gap)
        found += len(c.gap)
    assert found > 200


@pytest.mark.parametrize(
    ("first", "second", "flat"),
    [
        ("box", "box", False),
        ("cylinder", "box", False),
        ("prism", "ellipsoid", False),
        ("capsule", "box", False),
        ("ellipsoid", "cylinder", False),
        ("box", "box", True),
        ("prism", "box", True),
        ("box", "ellipsoid", True),
    ],
)
def test_gap_changes_at_the_normal_velocity_of_the_point(first, second, flat, rng):
    """d gap / dt = n · (v2 - v1) at the contact point, by central differences."""
    A, B = ALL[first], ALL[second]
    R1, R2, n = random_rotation(rng), random_rotation(rng), rng.normal(size=3)
    n /= np.linalg.norm(n)
    if flat:  # the upper end of the first, ±0.3 of the box and prism, under the second, upright
        n, R2 = R1[:, 2], R1 @ about((0, 0, 1), 0.3)
    x = np.array([np.zeros(3), support(A, R1, n + 1e-12) + 1e-2 * n - support(B, R2, -n + 1e-12)])
    if flat:
        x[1] = n * (n @ x[1])
    v, w = rng.normal(size=(2, 3)), rng.normal(size=(2, 3))
    d, h, reach = detector(A, B), 1e-6, np.full(2, 1e-2)
    c = d.find(x, np.array([R1, R2]), reach, ContactSet.empty())
    assert c.gap.min() == pytest.approx(1e-2, abs=1e-6)
    gaps = {}
    for s in (-h, h):
        turned = np.array([about(w[0], s) @ R1, about(w[1], s) @ R2])
        moved = d.find(x + s * v, turned, reach, c)
        gaps[s] = dict(zip(moved.key.tolist(), moved.gap.tolist(), strict=True))
    arm1, arm2 = c.point - x[0], c.point - x[1]
    speed = np.sum(c.normal * (v[1] + np.cross(w[1], arm2) - v[0] - np.cross(w[0], arm1)), axis=1)
    rate = [(gaps[h][k] - gaps[-h][k]) / (2 * h) for k in c.key.tolist()]
    # Round-off 1e-16 / h, and (h / gap)² where corners touch.
    np.testing.assert_allclose(rate, speed, rtol=0, atol=1e-7)


# -- reduction ---------------------------------------------------------------------------------------------


def polygon(count, radius=1.0):
    angle = 2 * np.pi * np.arange(count) / count
    return np.column_stack((radius * np.cos(angle), radius * np.sin(angle)))


@pytest.mark.parametrize("sides", [16, 24, 31, 64])
@pytest.mark.parametrize("limit", [4, 8])
def test_reduction_keeps_the_area_of_what_is_flush_and_the_lower_half_of_what_is_tilted(sides, limit):
    """Of a prism on a plane; the largest inscribed octagon has 90 % of a disk, the largest square 63.7 %.

    Four neighbours of a rim and four other points span at least a pentagon, 75.6 %, two and two a triangle, 41.3 %.
    """
    ring = polygon(sides)
    shape, _ = shapes.convex(np.vstack([np.column_stack((ring, np.full(sides, z))) for z in (-0.5, 0.5)]))
    whole = 0.5 * sides * np.sin(2 * np.pi / sides)
    for tilt, share in ((0.0, (0.9, 0.6)), (1e-4, (0.75, 0.41))):
        R = about((np.cos(1.0), np.sin(1.0), 0), tilt)
        c = contacts_of((GROUND, np.zeros(3), UPRIGHT), (shape, (0, 0, 0.5), R), reach=1e-3, max_points=limit)
        assert len(c.gap) == limit
        assert area(c) > share[limit == 4] * whole
        half = np.sort(shape.vertices @ R[2])[: limit // 2 if tilt else 1] + 0.5
        np.testing.assert_allclose(np.sort(c.gap)[: half.size], half, rtol=0, atol=1e-15)


@pytest.mark.parametrize("feet", [3, 6, 20])
def test_an_almost_flat_sole_keeps_the_points_on_which_it_rests(feet):
    """Inside of a rim that is 1e-4 higher: a sole of three points, of a hexagon, of twenty sides."""
    inner, outer = 0.5 * polygon(feet), polygon(16)
    layers = np.c_[inner, np.zeros(feet)], np.c_[outer, np.full(16, 1e-4)], np.c_[outer, np.ones(16)]
    shape, centroid = shapes.convex(np.vstack(layers))
    c = contacts_of((GROUND, np.zeros(3), UPRIGHT), (shape, (0, 0, centroid[2]), UPRIGHT), reach=1e-3)
    assert len(c.gap) == 8
    assert (c.gap < 1e-12).sum() == min(feet, 8)


def test_points_inside_the_patch_are_given_up_first():
    """A deep point inside the hull is kept beside the corners."""
    top = polygon(12)
    cone = np.vstack((np.column_stack((top, np.zeros(12))), [[0.0, 0.0, -1e-4], [0.0, 0.0, 1.0]]))
    shape, centroid = shapes.convex(cone)
    c = contacts_of((GROUND, np.zeros(3), UPRIGHT), (shape, (0, 0, centroid[2]), UPRIGHT), reach=1e-3)
    assert len(c.gap) == 8
    deepest = np.argmin(c.gap)
    np.testing.assert_allclose(c.point[deepest], [0, 0, -1e-4], rtol=0, atol=1e-14)
    rim = np.delete(c.point, deepest, axis=0)
    np.testing.assert_allclose(np.hypot(rim[:, 0], rim[:, 1]), 1.0, rtol=1e-12)


def test_both_ends_of_the_lowest_edge_are_kept():
    """Of five edges on which a prism of 40 sides may roll: their ends lie on two lines, so that four span all area."""
    ring = polygon(40)
    shape, _ = shapes.convex(np.vstack([np.column_stack((ring[:, 0], np.full(40, y), ring[:, 1])) for y in (-1, 1)]))
    c = contacts_of((GROUND, np.zeros(3), UPRIGHT), (shape, (0, 0, 1.0), about((0, 1, 0), 0.01)), reach=0.06)
    assert len(c.gap) == 8
    lowest = np.argsort(c.gap)[:2]
    # The corners are those of the shape, but for the round-off of its pose.
    np.testing.assert_allclose(np.sort(c.point[lowest, 1]), [-1, 1], rtol=0, atol=1e-14)
    np.testing.assert_allclose(c.gap[lowest], 1.0 - np.cos(0.01), rtol=0, atol=1e-14)


# -- keys --------------------------------------------------------------------------------------------------


def test_keys_last_while_a_box_slides_off_the_edge():
    """Corners of the sliding box are the same contacts, step after step; those at the edge of the other one too."""
    cube = shapes.box((1, 1, 1))
    d = detector(shapes.box((1.2, 3, 1)), cube)
    R = np.tile(np.eye(3), (2, 1, 1))
    seen, memory = [], ContactSet.empty()
    for k in range(100):
        c = memory = d.find(np.array([[0, 0, 0], [0.005 * k, 0, 1.0]]), R, np.zeros(2), memory)
        assert len(c.gap) == 4
        seen.append(dict(zip(c.key.tolist(), c.point.tolist(), strict=True)))
    trailing = [key for key, point in seen[0].items() if point[0] < 0]
    assert len(trailing) == 2
    assert all(key in contact for key in trailing for contact in seen)
    # The leading corners pass the edge once: at most one change of key each.
    assert set().union(*seen) <= set(range(6))


def test_keys_of_a_lasting_contact_do_not_depend_on_the_order_of_points(rng):
    """A cylinder that rocks about a line through its centre: the rim points turn, keys never come back."""
    d = detector(GROUND, CYLINDER)
    highest, memory = -1, ContactSet.empty()
    for k in range(50):
        R = about((np.cos(0.1 * k), np.sin(0.1 * k), 0), 1e-5)
        c = memory = d.find(np.array([[0, 0, 0.3]]), R[None], np.array([1e-3]), memory)
        assert len(set(c.key.tolist())) == len(c.gap) == 8
        new = c.key[c.key > highest]
        assert set(new.tolist()) == set(range(highest + 1, highest + 1 + len(new)))
        highest = max(highest, int(c.key.max()))


def everything(found):
    return b"".join(a.tobytes() for a in found[:3]), found.next_key


def test_find_is_a_function_of_its_arguments(rng):
    """Whatever configurations were seen in between, by this or another detector; and what it returned stays."""
    d, x, R = pile(rng)
    reach = np.full(len(x), 1e-3)
    velocity = 1e-3 * rng.uniform(-1, 1, size=x.shape)
    memory, run = ContactSet.empty(), []
    for k in range(8):
        found = d.find(x + k * velocity, R, reach, memory)
        run.append((memory, found, everything(found)))
        memory = found
    assert memory.next_key > len(run[0][1].key)
    fresh = detector(*CROWD)
    for k in reversed(range(8)):
        before, found, was = run[k]
        assert everything(found) == was
        alone(d, x + rng.normal(size=x.shape), R, 9 * reach)
        for each in (d, fresh):
            assert everything(each.find(x + k * velocity, R, reach, before)) == was


# -- Coal ---------------------------------------------------------------------------------------------------


def test_many_geoms_are_asked_in_batches(rng, monkeypatch):
    """The answer does not depend on how many geoms share a model."""
    d, x, R = pile(rng)
    c = alone(d, x, R, np.zeros(len(x)))
    monkeypatch.setattr(distances, "SLOTS", 5)
    small = detector(*CROWD)
    b = alone(small, x, R, np.zeros(len(x)))
    for one, two in zip(rows(c), rows(b), strict=True):
        assert one.tobytes() == two.tobytes()


def test_pairs_that_are_seen_to_be_apart_are_not_asked(rng, monkeypatch):
    """To the same bits, while bodies move in and out of each other's boxes."""
    (few, x, R), velocity = pile(rng), 0.02 * rng.normal(size=(len(CROWD) - 1, 3))
    reach = np.full(len(x), 1e-2)
    found = [alone(few, x + k * velocity, R, reach) for k in range(8)]
    left = np.isinf(few._coal[:, 0])
    assert 0.1 < left.mean() < 0.9
    monkeypatch.setattr(broadphase, "of_interest", lambda *_: 0)
    everybody = detector(*CROWD)
    for k in range(8):
        for one, two in zip(rows(found[k]), rows(alone(everybody, x + k * velocity, R, reach)), strict=True):
            assert one.tobytes() == two.tobytes()
    assert not np.isinf(everybody._coal[:, 0]).any()


def test_mesh_touches_as_its_hull(rng):
    """A hollow mesh (C6): its hull, with the points of a face, not of internal edges."""
    shape, _ = shapes.convex(
        [[0, 0, 0], [2, 0, 0], [2, 1, 0], [1, 2, 0], [0, 2, 0], [0, 0, 1], [2, 0, 1], [2, 1, 1], [1, 2, 1], [0, 2, 1]]
    )
    c = contacts_of((shapes.box((9, 9, 1)), np.zeros(3), UPRIGHT), (shape, (0, 0, 1.0), UPRIGHT))
    assert len(c.gap) == 5
    np.testing.assert_array_equal(c.normal, np.tile([0.0, 0.0, 1.0], (5, 1)))
    np.testing.assert_allclose(c.gap, 0.0, rtol=0, atol=1e-15)


def test_a_corner_just_below_the_border_of_a_tilted_face():
    """2.5 µm below it, 4.5 µm before it: neither crossing edges nor, to Coal's normal, the face part them best."""
    cube = shapes.box((0.1, 0.1, 0.1))
    x = np.array([0.09121501869287324, 0.10506000716932923, 0.05009437933772023])
    R = np.array(
        [
            [-0.6382693556889036, 0.001208672495733587, -0.769812164556569],
            [-0.7698108600805424, 0.0014174148077320536, 0.638270499582519],
            [0.0018626031588983571, 0.9999982650215253, 2.5756777421226396e-05],
        ]
    )
    y = np.array([0.1803714223634159, 0.1825153361423406, 0.05])
    S = np.array(
        [[-0.903596065218661, 0.0, -0.4283855167035335], [-0.4283855167035335, 0.0, 0.903596065218661], [0, 1, 0]]
    )
    c = contacts_of((cube, x, R), (cube, y, S))
    assert len(c.gap) > 0
    for place, turn in ((x, R), (y, S)):
        outside = np.abs((c.point - place) @ turn).max(axis=1) - 0.05
        np.testing.assert_allclose(outside, 0.0, rtol=0, atol=1e-4)


@pytest.mark.slow
def test_what_a_process_did_before_changes_no_bit():
    """Coal's answers for boxes that collide once depended on the scenes made before."""
    code = """
import warnings
import nsdyn as nd
warnings.simplefilter("ignore")
def run():
    setup = nd.scenes.setup("pile", boxes=3, spheres=3)
    stepper = nd.Stepper(setup.scene, **setup.options(on_fail="ignore"))
    for _ in range(60):
        step = stepper.step()
    return step.q.tobytes()
first = run()
nd.Stepper(nd.scenes.load("stack")(height=4), 5e-3)
print(first == run())
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "True\n"
