"""Manifolds are complete: their gaps, carried along a motion, foretell the distance of the bodies after it."""

import coal
import numpy as np
import pytest
from scipy.optimize import brentq
from test_contacts import BOX, CYLINDER, PRISM, ROCK, about, detector, random_rotation, solid, support

from nsdyn.audit import overlap
from nsdyn.audit.touching import from_surface
from nsdyn.collision.candidates import MARGIN
from nsdyn.collision.contacts import ContactSet
from nsdyn.scene import shapes

SHAPES = {
    "box": BOX,
    "plate": shapes.box((1.0, 0.8, 0.1)),
    "rod": shapes.box((0.1, 0.1, 1.0)),
    "prism": PRISM,
    "rock": ROCK,
    "sphere": shapes.sphere(0.4),
    "capsule": shapes.capsule(0.15, 0.8),
    "cylinder": CYLINDER,
    "pole": shapes.cylinder(0.1, 0.9),
    "disk": shapes.cylinder(0.5, 0.1),
    "ellipsoid": shapes.ellipsoid((0.2, 0.4, 0.5)),
}


def edge_directions(shape):
    """Unit vectors along the edges of a polytope, each direction once, shape (n, 3)."""
    faces = [shape.vertices[loop] for loop in np.split(shape.face_loop, shape.face_ptr[1:-1])]
    e = np.concatenate([np.roll(f, -1, axis=0) - f for f in faces])
    e /= np.linalg.norm(e, axis=1)[:, None]
    e *= np.sign(e[np.arange(len(e)), np.abs(e).argmax(axis=1)])[:, None]
    return np.unique(e.round(9), axis=0)


EDGES = {name: edge_directions(s) for name, s in SHAPES.items() if len(s.vertices)}


def separation(a, b, x, R, n):
    """Width of the slab of normal n between two shapes: no more than their signed distance, whatever n is."""
    return n @ (x[1] + support(SHAPES[b], R[1], -n) - x[0] - support(SHAPES[a], R[0], n))


def distance(a, b, x, R):
    """Signed distance of two shapes and its normal, by separating axes or by Coal; of overlaps, the depth."""
    A, B = SHAPES[a], SHAPES[b]
    if a in EDGES and b in EDGES:
        cross = np.cross((EDGES[a] @ R[0].T)[:, None], EDGES[b] @ R[1].T).reshape(-1, 3)
        length = np.linalg.norm(cross, axis=1)
        cross = cross[length > 1e-7] / length[length > 1e-7, None]
        axes = np.concatenate((A.face_normals @ R[0].T, -B.face_normals @ R[1].T, cross, -cross))
        gaps = (axes @ (B.vertices @ R[1].T + x[1]).T).min(axis=1) - (axes @ (A.vertices @ R[0].T + x[0]).T).max(axis=1)
        return gaps.max(), axes[gaps.argmax()]
    request = coal.DistanceRequest()
    request.gjk_tolerance = 1e-9
    best, normal = -np.inf, np.zeros(3)
    for first, second, sign in ((0, 1, 1.0), (1, 0, -1.0)):  # in one order it sometimes fails
        result, solid = coal.DistanceResult(), (A.geometry, B.geometry)
        pose = [coal.Transform3s(R[k], x[k]) for k in (first, second)]
        d = coal.distance(solid[first], pose[0], solid[second], pose[1], request, result)
        if best < d < 10.0 and d > -10.0:
            best, normal = d, sign * np.array(result.normal)
    return best, normal


def flat_side_up(shape, rng):
    """Rotation that turns a face, cap or side of a shape upwards."""
    if len(shape.vertices):
        n = shape.face_normals[rng.integers(len(shape.face_normals))]
    else:
        n = np.array([(0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (1.0, 0.0, 0.0)][rng.integers(3)])
    axis = np.cross(n, (0.0, 0.0, 1.0))
    sine = np.linalg.norm(axis)
    if sine < 1e-9:
        return np.diag([1.0, -1.0, -1.0]) if n[2] < 0.0 else np.eye(3)
    return about(axis / sine, np.arctan2(sine, n[2]))


def close_pair(a, b, gap, rng):
    """Poses of two shapes at a signed distance, in any orientation or with sides nearly parallel."""
    A, B = SHAPES[a], SHAPES[b]
    if rng.random() < 0.25:
        R = np.array([random_rotation(rng), random_rotation(rng)])
    else:
        yaw = (0.0, 0.5 * np.pi, rng.uniform(0.0, 2.0 * np.pi))[rng.integers(3)]
        way = rng.uniform(0.0, 2.0 * np.pi)
        tilt = 10.0 ** rng.uniform(-5.0, -0.3) * (rng.random() < 0.7)
        flip = about((0, 0, 1), yaw) @ np.diag([1.0, -1.0, -1.0])
        lower = about((np.cos(way), np.sin(way), 0), tilt) @ flip @ flat_side_up(B, rng)
        R = np.array([flat_side_up(A, rng), lower])
    x = np.zeros((2, 3))
    x[1, :2] = rng.uniform(-0.6, 0.6, size=2) * (rng.random(2) < 0.7) * min(A.bounding_radius, B.bounding_radius)

    def excess(height):
        x[1, 2] = height
        return max(distance(a, b, x, R)[0], -10.0) - gap  # no distance where Coal fails

    if excess(0.0) < 0.0:  # else beside each other
        x[1, 2] = brentq(excess, 0.0, A.bounding_radius + B.bounding_radius + 0.1, xtol=1e-12)
    Q, origin = random_rotation(rng), rng.normal(size=3)
    return x @ Q.T + origin, Q @ R


@pytest.mark.parametrize("overlap", [False, True], ids=["apart", "overlapping"])
@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2)), 3])
def test_gaps_along_a_motion_foretell_the_distance(seed, overlap):
    """No pair is deeper after it than the manifold says, but for the square of the motion; and the gap is the distance.

    Of a flat end of a cylinder 8 points stand for the circle: between them it is lower by 1 - cos(π/8) = 7.6 % of the
    radius times the rotation.
    """
    rng = np.random.default_rng(seed)
    names, tried = list(SHAPES), 0
    for _ in range(100):
        a, b = rng.choice(names, size=2)
        A, B = SHAPES[a], SHAPES[b]
        size = min(A.bounding_radius, B.bounding_radius)
        motion = 10.0 ** rng.uniform(-3.0, -1.3)
        gap = 0.5 * motion * size * 10.0 ** rng.uniform(-2.0, 0.0)
        if overlap:
            gap = -min(A.inscribed_radius, B.inscribed_radius) * 10.0 ** rng.uniform(-3.0, -1.0)
        x, R = close_pair(a, b, gap, rng)
        before, n = distance(a, b, x, R)
        if abs(before - gap) > 1e-6:  # beside each other, or Coal failed
            continue
        tried += 1
        v, w = rng.normal(size=(2, 3))
        v *= rng.uniform() * motion * size / np.linalg.norm(v)
        v -= n * (n @ v + rng.uniform() * motion * size)  # towards each other
        w *= rng.uniform() * motion / np.linalg.norm(w)
        reach = np.array([0.0, np.linalg.norm(v) + np.linalg.norm(w) * B.bounding_radius])
        c = detector(A, B).find(x, R, reach, ContactSet.empty())

        # Of disjoint polytopes the widest slab may be narrower than the distance, and this beyond the margin.
        assert c.gap.min(initial=np.inf) > before - 3e-6
        assert not overlap or c.gap.min() < before + 3e-6
        foretold = (c.gap + np.sum(c.normal * (v + np.cross(w, c.point - x[1])), axis=1)).min(initial=np.inf)
        x[1] += v
        R[1] = about(w, 1.0) @ R[1]
        after, _ = distance(a, b, x, R)
        # Coal's depth of shallow overlaps may be wrong, but no slab is wider than the distance.
        after = max([after, *(separation(a, b, x, R, about(w, s) @ m) for m in c.normal for s in (0.0, 1.0))])
        size_of_motion = np.linalg.norm(v) / size + np.linalg.norm(w)
        allowed = 5.0 * size_of_motion**2 * size + 1e-6
        # Deep inside each other, other features than those found are that much beside them.
        allowed += size_of_motion * max(-before, 0.0)
        for shape in (A, B):
            if solid(shape).smooth and len(solid(shape).normals):
                allowed += (1.0 - np.cos(np.pi / 8)) * np.linalg.norm(w) * shape.size[0]
        assert min(after, 0.0) > min(foretold, 0.0) - allowed, (a, b)
    assert tried > 75


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2, 3))])
def test_what_overlaps_is_parted_along_the_normals(seed):
    """Along the normal of a contact that is closed polytopes overlap no more than they do.

    Also beside the face that comes closest to the edges that meet; 1e-5 is what a face may separate less.
    """
    rng, tried = np.random.default_rng(seed), 0
    for _ in range(150):
        a, b = rng.choice(list(EDGES), size=2)
        A, B = SHAPES[a], SHAPES[b]
        size = min(A.bounding_radius, B.bounding_radius)
        depth = min(A.inscribed_radius, B.inscribed_radius) * 10.0 ** rng.uniform(-3.0, -1.0)
        x, R = close_pair(a, b, -depth, rng)
        before, _ = distance(a, b, x, R)
        if abs(before + depth) > 1e-6:  # beside each other
            continue
        tried += 1
        reach = np.array([0.0, 0.1 * size * rng.uniform()])
        c = detector(A, B).find(x, R, reach, ContactSet.empty())
        assert min(separation(a, b, x, R, n) for n in c.normal[c.gap < 0.0]) > before - 1e-5 * size, (a, b)
    assert tried > 100


@pytest.mark.parametrize("reach", [0.0, 1e-3, 1e-2])
def test_normals_are_those_along_which_a_motion_may_bring_the_bodies_to_touch(reach, rng):
    """Elsewhere they overlap along them farther than the motion goes: as of an end of a rod near an edge, beside it."""
    for _ in range(300):
        a, b = rng.choice(list(SHAPES), size=2)
        x, R = close_pair(a, b, 1e-4, rng)
        c = detector(SHAPES[a], SHAPES[b]).find(x, R, np.full(2, reach), ContactSet.empty())
        sizes = [SHAPES[name].bounding_radius for name in (a, b)]
        farthest = (2.0 * reach + MARGIN * min(sizes)) * max(sizes) / min(sizes)
        least = min((separation(a, b, x, R, n) for n in c.normal), default=0.0)
        assert least > min(c.gap.min(initial=0.0), 0.0) - farthest - 1e-9, (a, b)


CUBE = shapes.box((1.0, 1.0, 1.0))


@pytest.mark.parametrize("gap", [0.02, -0.02])
def test_what_is_over_the_border_of_a_face_meets_its_edge(gap):
    """Crossing edges are met along their common normal alone, whatever the margin, not along that of a face."""
    R = np.array([about((1, 0, 0), 0.25 * np.pi - 0.6), about((0, 0, 1), 0.5 * np.pi) @ about((1, 0, 0), 0.25 * np.pi)])
    top = (CUBE.vertices @ R[0].T)[:, 2].max()
    edge = CUBE.vertices[np.argmax((CUBE.vertices @ R[0].T)[:, 2])] @ R[0].T
    x = np.array([[0.0, 0.0, 0.0], [0.1, edge[1], top + gap + np.sqrt(0.5)]])
    c = detector(CUBE, CUBE).find(x, R, np.array([0.0, 0.05]), ContactSet.empty())
    assert c.gap.min() == pytest.approx(gap, abs=1e-14)
    np.testing.assert_allclose(c.normal, np.tile([0.0, 0.0, 1.0], (len(c.gap), 1)), rtol=0, atol=1e-14)


@pytest.mark.parametrize("tilt", [1.9e-4, 2.1e-4, 2.6e-4, 2.8e-4, 4e-4])
def test_edges_beside_a_face_that_hardly_tilts_meet_where_they_cross(tilt):
    """The diagonal of the face tilts less than the face, and is no edge."""
    R = np.array([about((1, 0, 0), tilt), about((0, 1, 0), 0.25 * np.pi)])
    top = R[0] @ (0.0, 0.5, 0.5)
    x = np.array([[0.0, 0.0, 0.0], [0.1, 0.7, top[2] + np.sqrt(0.5) - 1e-5]])
    c = detector(CUBE, CUBE).find(x, R, np.array([0.0, 0.0]), ContactSet.empty())
    deepest = c.gap.argmin()
    np.testing.assert_allclose(c.point[deepest], (0.1, top[1], top[2] - 0.5e-5), rtol=0, atol=1e-5)
    np.testing.assert_allclose(c.normal[deepest], (0.0, 0.0, 1.0), rtol=0, atol=tilt + 1e-9)


@pytest.mark.parametrize("swapped", [False, True])
@pytest.mark.parametrize("shape", ["sphere", "capsule"])
def test_what_is_round_beside_a_face_meets_its_edge(shape, swapped):
    """Beyond the border by any angle, and in it by any depth, in the direction of the nearest point of the edge."""
    round_, radius = SHAPES[shape], SHAPES[shape].size[0]
    order = [1, 0] if swapped else [0, 1]
    both = [(CUBE, round_)[k] for k in order]
    for angle in (1e-6, 1e-5, 1e-4, 5e-4, 2e-3, 2e-2, 0.5):
        for depth in (1e-6, 1e-4, 1e-2, 0.4):
            n = np.array([0.0, np.sin(angle), np.cos(angle)])
            x = np.array([np.zeros(3), (0.1, 0.5, 0.5) + radius * (1.0 - depth) * n])
            lying = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]) if shape == "capsule" else np.eye(3)
            R = np.array([np.eye(3), lying])
            c = detector(*both).find(x[order], R[order], np.zeros(2), ContactSet.empty())
            assert len(c.gap) == (2 if shape == "capsule" else 1)
            np.testing.assert_allclose(c.gap, -depth * radius, rtol=0, atol=1e-9)
            np.testing.assert_allclose(c.normal, np.tile(-n if swapped else n, (len(c.gap), 1)), rtol=0, atol=1e-9)
            middle = np.array([0.5, 0.5]) - 0.5 * depth * radius * n[1:]
            np.testing.assert_allclose(c.point[:, 1:], np.tile(middle, (len(c.gap), 1)), rtol=0, atol=1e-9)


def test_cylinders_side_by_side_touch_where_both_are(rng):
    """Almost parallel ones, of which one ends beside the other: its rim touches that side, no point beyond its end."""
    a, b = shapes.cylinder(0.4, 0.3), shapes.cylinder(0.35, 0.5)
    pair, closed = detector(a, b), 0
    for _ in range(200):
        tilt, lean = 10.0 ** rng.uniform(-4.0, -1.0), 10.0 ** rng.uniform(-7.0, -3.0) * rng.choice((-1.0, 1.0))
        R = np.array([np.eye(3), about((1, 0, 0), tilt) @ about((0, 1, 0), lean)])
        x = np.array([[0.0, 0.0, 0.0], [0.75 - 1e-5, 0.0, rng.uniform(-0.3, 0.3)]])
        c = pair.find(x, R, np.zeros(2), ContactSet.empty())
        for k in np.flatnonzero(c.gap <= 0.0):
            closed += 1
            for shape, there, turn in zip((a, b), x, R, strict=True):
                off = from_surface(solid(shape), ((c.point[k] - there) @ turn)[None])[0]
                assert off <= 1e-3 * 0.3, (tilt, lean, x[1, 2], c.point[k])  # as audits have it
    assert closed > 150


@pytest.mark.parametrize("swapped", [False, True])
def test_an_edge_crosses_the_side_of_a_cylinder_near_its_corner(swapped, rng):
    """Coal's normal, whose error is that of a distance, does not tell there whether the edge or its corner touches."""
    radius, gap, order = 0.3, 1e-3, [1, 0] if swapped else [0, 1]
    for near in 10.0 ** rng.uniform(-5.0, -3.0, 60):
        tent, centre = shapes.convex([(0, 0, 0), (0.7, 0, 0), (0.1, 0.3, -0.3), (-0.1, -0.3, -0.3), (0.7, 0.2, -0.4)])
        turn, world = about((0, 0, 1), rng.uniform(0.2, 1.5)), random_rotation(rng)
        foot = np.array([0.4 * rng.uniform(-1, 1), 0.0, -radius - gap])
        x = np.array([np.zeros(3), foot + turn @ (centre - (0.7 * near, 0.0, 0.0))]) @ world.T
        R = world @ np.array([about((0, 1, 0), np.pi / 2), turn])
        both = [(shapes.cylinder(radius, 1.2), tent)[k] for k in order]
        c = detector(*both).find(x[order], R[order], np.full(2, 0.5 * gap), ContactSet.empty())
        k = c.gap.argmin()
        np.testing.assert_allclose(c.gap[k], gap, rtol=0, atol=1e-6)
        np.testing.assert_allclose(c.point[k], world @ (foot + np.array((0.0, 0.0, 0.5 * gap))), rtol=0, atol=2e-3)


def test_rims_touch_where_both_are(rng):
    """The rim of a tilted cylinder beside, or over, the rim of another, to within round-off or not."""
    for _ in range(80):
        radius, height = rng.uniform(0.5, 1.0, 2), 10.0 ** rng.uniform(-1.3, 0.0, 2)
        a, b = (shapes.cylinder(r, h) for r, h in zip(radius, height, strict=True))
        tilt = about((0, 0, 1), rng.uniform(0, 2 * np.pi)) @ about((1, 0, 0), 10.0 ** rng.uniform(-2.0, -0.5))
        down = np.array([0.0, 0.0, -1.0]) - tilt[:, 2] * -tilt[2, 2]
        lowest = radius[1] * down / np.linalg.norm(down) - 0.5 * height[1] * tilt[:, 2]
        out, depth = 10.0 ** rng.uniform(-6.0, -1.5, 2) * rng.choice((-1.0, 1.0), 2)
        foot = about((0, 0, 1), rng.uniform(0, 2 * np.pi)) @ (radius[0] + out, 0.0, 0.5 * height[0] - 0.3 * depth)
        world = random_rotation(rng)
        x, R = np.array([np.zeros(3), foot - lowest]) @ world.T, world @ np.array([np.eye(3), tilt])
        c = detector(a, b).find(x, R, np.full(2, 0.02), ContactSet.empty())
        k = c.gap.argmin()
        for shape, there, turn in zip((a, b), x, R, strict=True):
            off = from_surface(solid(shape), ((c.point[k] - there) @ turn)[None])[0]
            assert off <= abs(c.gap[k]) + 1e-3 * 0.5 * min(height), (radius, height, out, depth)


def test_coins_touch_over_both_of_them(rng):
    """Rims that cross beside almost parallel axes: no normal between these is better by more than round-off."""
    for _ in range(300):
        radius, thick = rng.uniform(0.5, 1.5, 2), 0.2
        a, b = (shapes.cylinder(r, thick) for r in radius)
        tilts = rng.normal(size=(2, 3)) * 10.0 ** rng.uniform(-7.0, -5.0, (2, 1))
        R = np.array([about(w, np.linalg.norm(w)) for w in tilts])
        x = np.zeros((2, 3))
        x[1, :2] = about((0, 0, 1), rng.uniform(0, 2 * np.pi))[:2, 0] * rng.uniform(0.9, 0.98) * radius.sum()
        x[1, 2] = thick + 1e-6 * rng.uniform(-1.0, 1.0)
        c = detector(a, b).find(x, R, np.full(2, 2e-6), ContactSet.empty())
        for at, r in zip(x, radius, strict=True):
            assert (np.linalg.norm((c.point - at)[:, :2], axis=1) <= r + 1e-5).all()
        exact = overlap.separation(solid(a), R[:1], x[:1], solid(b), R[1:], x[1:], exact=True)[0]
        assert -1e-15 <= c.gap.min() - exact <= 1e-10  # the audit's search for the best normal ends that near


def test_a_tilted_cap_touches_an_edge_where_both_are(rng):
    """The lowest point of its rim jumps along the edge as the normal turns: at the wrong one an end seems to touch."""
    size, radius, height = np.array((0.083, 0.127, 0.109)), 0.074, 0.15
    box, cap = shapes.box(size), shapes.cylinder(radius, height)
    for tilt in 10.0 ** rng.uniform(-3.5, -2.5, 40):
        x, R = np.zeros((2, 3)), np.array([np.eye(3), about((0.98, -0.19, 0.0), tilt)])
        x[1] = 0.01 + rng.uniform(-0.005, 0.005), 0.003 + rng.uniform(-0.005, 0.005), 0.5 * (size[2] + height) + 0.001
        for _ in range(3):
            x[1, 2] -= overlap.separation(solid(box), R[:1], x[:1], solid(cap), R[1:], x[1:], exact=True)[0]
        c = detector(box, cap).find(x, R, np.full(2, 1e-6), ContactSet.empty())
        k = c.gap.argmin()
        assert abs(c.gap[k]) < 1e-6
        for shape, there, turn in zip((box, cap), x, R, strict=True):
            assert from_surface(solid(shape), ((c.point[k] - there) @ turn)[None])[0] <= abs(c.gap[k]) + 1e-6


@pytest.mark.parametrize("lower", ["capsule", "pole"])
@pytest.mark.parametrize("upper", ["capsule", "pole"])
def test_round_ones_that_cross_almost_parallel_touch_between_their_ends(lower, upper, rng):
    """By the square of the tilt times half of their length, over the radii: up to 1e-5 of a radius here."""
    side = about((0, 1, 0), 0.5 * np.pi)
    a, b = solid(SHAPES[lower]), solid(SHAPES[upper])
    for tilt in 10.0 ** rng.uniform(-7.0, -2.0, 100):
        x = np.array([np.zeros(3), (rng.uniform(-0.3, 0.3), 0.3 * tilt * rng.normal(), 0.0)])
        R = np.array([side, about((0, 0, 1), tilt) @ about((0, 1, 0), 0.1 * tilt * rng.normal()) @ side])
        x[1, 2] = a.rounding + b.rounding - 1e-7 * rng.uniform()
        c = detector(SHAPES[lower], SHAPES[upper]).find(x, R, np.full(2, 1e-3), ContactSet.empty())
        exact = overlap.separation(a, R[:1], x[:1], b, R[1:], x[1:], exact=True)[0]
        np.testing.assert_allclose(c.gap.min(), exact, rtol=0, atol=2e-9)


@pytest.mark.parametrize("lower", ["box", "prism", "plate", "disk"])
def test_caps_almost_flat_on_a_face_have_their_lowest_point(lower, rng):
    """Eight points stand for the circle: between them it is up to 7.6 % of a radius times the tilt lower."""
    cap = shapes.cylinder(0.3, 0.2)
    a, b, pair = solid(SHAPES[lower]), solid(cap), detector(SHAPES[lower], cap)
    for tilt in 10.0 ** rng.uniform(-8.5, -4.0, 100):
        lie = np.eye(3) if lower == "disk" else flat_side_up(SHAPES[lower], rng)
        way, x = rng.uniform(0.0, 2.0 * np.pi), np.zeros((2, 3))
        R = np.array([lie, about((np.cos(way), np.sin(way), 0.0), tilt)])
        x[1] = *rng.uniform(-0.2, 0.2, 2), 2.0
        x[1, 2] -= 1e-7 * rng.uniform() + overlap.separation(a, R[:1], x[:1], b, R[1:], x[1:], exact=True)[0]
        c = pair.find(x, R, np.full(2, 1e-3), ContactSet.empty())
        k, exact = c.gap.argmin(), overlap.separation(a, R[:1], x[:1], b, R[1:], x[1:], exact=True)[0]
        np.testing.assert_allclose(c.gap[k], exact, rtol=0, atol=2e-8 * 0.3)
        for shape, there, turn in zip((SHAPES[lower], cap), x, R, strict=True):
            assert from_surface(solid(shape), ((c.point[k] - there) @ turn)[None])[0] <= abs(c.gap[k]) + 1e-8


def test_a_cap_on_a_face_that_errs_by_its_tilt(rng):
    """The corner outermost along the normal of the face is not where the rim touches, but an edge that ends there."""
    box, cap = shapes.box((0.09429, 0.17267, 0.13143)), shapes.cylinder(0.113, 0.11364)
    there, tilt = np.array((0.00222, -0.11274, 0.12253)), about((-0.6943, 0.7197, 0.0), 4.75e-5)
    poses = np.eye(3)[None], np.zeros((1, 3)), solid(cap), tilt[None], there[None]
    there[2] -= 1e-6 + overlap.separation(solid(box), *poses, exact=True)[0]
    for _ in range(10):
        world = random_rotation(rng)
        x, R = np.array([np.zeros(3), world @ there]), np.array([world, world @ tilt])
        c = detector(box, cap).find(x, R, np.full(2, 1e-5), ContactSet.empty())
        k = c.gap.argmin()
        np.testing.assert_allclose(c.gap[k], -1e-6, rtol=0, atol=1e-8)
        for shape, at, turn in zip((box, cap), x, R, strict=True):
            assert from_surface(solid(shape), ((c.point[k] - at) @ turn)[None])[0] <= 2e-6


@pytest.mark.parametrize(("inset", "on_face"), [(0.005, False), (0.1, True)])
def test_a_corner_that_may_leave_a_face_meets_its_edge(inset, on_face):
    """An edge dips beyond the border, askew: the face stops its corner only far from there."""
    R = about((0, 0, 1), 0.4 * np.pi) @ about((0, 1, 0), 1e-3) @ about((1, 0, 0), 0.5)
    corners = CUBE.vertices @ R.T
    corner = corners[corners[:, 0].round(2) == 0.03][0]
    x = np.array([[0.0, 0.0, 0.0], np.array([0.5 - inset, 0.0, 0.5 + 0.01 * inset]) - corner])
    c = detector(CUBE, CUBE).find(x, np.array([np.eye(3), R]), np.array([0.0, 0.02]), ContactSet.empty())
    upright = np.linalg.norm(c.normal - (0, 0, 1), axis=1) < 1e-9
    np.testing.assert_allclose(c.point[1], x[1] + corner, rtol=0, atol=1e-15)
    assert c.gap[1] == pytest.approx(0.01 * inset, rel=1e-4) and upright.tolist() == [False, on_face]


def cubes_tilted(tilt):
    """A cube on another one, aligned but tilted about y by an angle, the lower edge a little above."""
    R = about((0, 1, 0), tilt)
    z = 0.5 + 0.01 * tilt - (CUBE.vertices @ R.T)[:, 2].min()
    x = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, z]])
    reach = np.array([0.0, 2.0 * tilt])
    return detector(CUBE, CUBE).find(x, np.array([np.eye(3), R]), reach, ContactSet.empty())


@pytest.mark.parametrize("tilt", [1e-5, 1e-4, 3e-4, 1e-3, 1e-2, 0.1])
def test_a_tilted_box_has_all_its_corners(tilt):
    """Whichever feature is closest: two corners down, two up by the tilt."""
    c = cubes_tilted(tilt)
    assert np.sum(c.gap < 0.1 * tilt) == 2
    assert np.sum(np.abs(c.gap - np.sin(tilt)) < 0.1 * tilt) == 2
    assert len(c.gap) == 4


def test_high_points_do_not_displace_low_ones():
    """A ball of many facets above a face: the corners that are kept are its lowest ones, whatever the margin."""
    k = np.arange(400) + 0.5
    z, phi = 1.0 - 2.0 * k / 400, np.pi * (1.0 + np.sqrt(5.0)) * k
    ring = np.sqrt(1.0 - z * z)
    ball, _ = shapes.convex(np.column_stack((ring * np.cos(phi), ring * np.sin(phi), z)))
    floor = shapes.box((5.0, 5.0, 1.0))
    x = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.5 + 1e-3]])
    c = detector(floor, ball).find(x, np.tile(np.eye(3), (2, 1, 1)), np.array([0.0, 0.3]), ContactSet.empty())
    heights = np.sort(ball.vertices[:, 2]) + 1.0 + 1e-3
    assert len(c.gap) == 8
    assert c.gap.min() == pytest.approx(heights[0], abs=1e-12)
    assert c.gap.max() < heights[24]


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_points_of_nearly_flush_boxes_are_on_both(seed):
    """Edges may separate better than a face by 1e-6 alone: where they cross is the contact, not between any corners."""
    rng, tried = np.random.default_rng(seed), 0
    for _ in range(600):
        a, b = (shapes.box(tuple(10.0 ** rng.uniform(-1.0, 0.2, size=3))) for _ in range(2))
        size = min(a.bounding_radius, b.bounding_radius)
        tilt = 10.0 ** rng.uniform(-5.2, -3.7)
        way, yaw = rng.uniform(0.0, 2.0 * np.pi, size=2)
        lean = about((np.cos(way), np.sin(way), 0), tilt) @ about((0, 0, 1), yaw)
        x = np.zeros((2, 3))
        x[1, :2] = rng.uniform(-0.4, 0.4, size=2) * (a.size[:2] + b.size[:2])
        Q = random_rotation(rng)
        R = np.array([np.eye(3), lean])
        depth = 5e-3 * min(a.inscribed_radius, b.inscribed_radius)
        x[1, 2] = (a.vertices[:, 2].max() - (b.vertices @ lean.T)[:, 2].min()) - depth
        c = detector(a, b).find(x @ Q.T, Q @ R, np.zeros(2), ContactSet.empty())
        closed = c.point[c.gap < 0.0]
        tried += len(closed) > 0
        for shape, at, turned in ((a, x[0], R[0]), (b, x[1], R[1])):
            local = (closed @ Q - at) @ turned
            outside = (np.abs(local) - shape.size / 2).max(initial=0.0)
            assert outside <= depth + 1e-6 * size
    assert tried > 300


@pytest.mark.parametrize("swapped", [False, True])
def test_edges_side_by_side_do_not_touch(swapped, rng):
    """A bar on a plate, over its border and tilted by round-off: edges with no height between them are apart."""
    order = [1, 0] if swapped else [0, 1]
    for _ in range(100):
        plate, bar = shapes.box((rng.uniform(0.5, 2.0), 0.1, 0.1)), shapes.box((rng.uniform(0.01, 0.05), 0.1, 0.1))
        tilt = 10.0 ** rng.uniform(-7.0, -6.0) * rng.choice((-1.0, 1.0))
        R = np.array([np.eye(3), about((0, 1, 0), tilt)])
        beyond = rng.uniform(0.1, 0.9) * bar.size[0]
        x = np.array([(0.0, 0.0, 0.0), (0.5 * (plate.size[0] - bar.size[0]) + beyond, 1e-9 * rng.normal(), 0.1)])
        both = [(plate, bar)[k] for k in order]
        c = detector(*both).find(x[order], R[order], np.zeros(2), ContactSet.empty())
        assert len(c.gap) >= 2
        for shape, at, turned in zip((plate, bar), x, R, strict=True):
            outside = np.abs((c.point - at) @ turned) - shape.size / 2
            assert outside.max() <= 1e-3 * bar.inscribed_radius
