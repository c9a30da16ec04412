"""Motion between two poses: what touches on the way is found, what passes clear is not."""

import coal
import numpy as np
import pinocchio as pin
import pytest
from test_contacts import ALL, GROUND, about, detector, random_rotation

from nsdyn._kernels.collision import advancement
from nsdyn.collision.contacts import ContactSet, carry
from nsdyn.dynamics.values import Placement
from nsdyn.scene import shapes

EMPTY = ContactSet.empty()
THIN = {"plate": shapes.box((1.0, 0.8, 0.01)), "pin": shapes.cylinder(0.01, 1.0), "pea": shapes.sphere(0.02)}
KINDS = {**ALL, **THIN}


def poses(*placed):
    """Poses of frames from (x, R)."""
    return Placement(np.array([p[0] for p in placed], dtype=float), np.array([p[1] for p in placed], dtype=float), ())


def between(begin, end, s):
    """Poses at the fraction s of the way."""
    turn = [s * pin.log3(b @ a.T) for a, b in zip(begin.R, end.R, strict=True)]
    R = np.array([pin.exp3(w) @ a for w, a in zip(turn, begin.R, strict=True)])
    return Placement(begin.x + s * (end.x - begin.x), R, ())


def distance(A, B, where):
    """Coal's signed distance of the shapes of frames 0 and 1."""
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    request.gjk_tolerance = 1e-9
    a, b = (coal.Transform3s(R, x) for x, R in zip(where.x, where.R, strict=True))
    return coal.distance(A.geometry, a, B.geometry, b, request, result)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_against_dense_sampling(seed):
    """All kinds of shapes, thin ones among them, up to 1 m and 1 rad each on the way."""
    rng = np.random.default_rng(seed)
    names = list(KINDS)
    outcomes = [0, 0]
    for _ in range(60):
        A, B = (KINDS[name] for name in rng.choice(names, size=2))
        size = min(A.bounding_radius, B.bounding_radius)
        direction = rng.normal(size=3)
        apart = (A.bounding_radius + B.bounding_radius) * direction / np.linalg.norm(direction)
        x0 = np.array([np.zeros(3), apart * rng.uniform(0.8, 1.2)])
        R0 = np.array([random_rotation(rng), random_rotation(rng)])
        x1 = x0 + rng.uniform(-0.5, 0.5, size=(2, 3))
        x1[1] -= apart * rng.uniform(0.5, 2.0)
        turn = rng.uniform(-1.0, 1.0, size=(2, 3)) / np.sqrt(3.0)
        begin = Placement(x0, R0, ())
        end = Placement(x1, np.array([pin.exp3(w) @ R for w, R in zip(turn, R0, strict=True)]), ())
        if distance(A, B, begin) < 1e-3:
            continue
        samples = np.array([distance(A, B, between(begin, end, s)) for s in np.linspace(0.0, 1.0, 500)])
        samples = np.where(np.abs(samples) < 10.0, samples, -1e-2)  # Coal's answer where it finds no depth
        d = detector(A, B)
        found = d.touches(begin, end, EMPTY)
        if samples.min() > 5e-3:  # between two of them it may come closer
            assert found.codes.size == 0
            outcomes[0] += 1
        if samples.min() < 0.0:
            outcomes[1] += 1
            s = found.fraction[0]
            first = np.argmax(samples < 0.0) / 499
            assert first - 0.2 < s <= first  # no later than the first sample inside
            assert -1e-7 < distance(A, B, between(begin, end, s)) < 1.001e-4 * size
            there = between(begin, end, s)
            manifold, hit = d.find(*there[:2], np.zeros(2), EMPTY), d.carried(found, end, EMPTY)[0]
            np.testing.assert_allclose(hit.gap, carry(manifold, there, end).gap, rtol=0, atol=1e-6)
    assert min(outcomes) > 5


@pytest.mark.parametrize("angle", [0.3, 0.9])
def test_the_tip_of_a_blade_hits_what_is_in_its_way(angle):
    """At 100 m/s, 1 rad in a step of 5 ms, 1 cm thick: a ball of 1 cm radius near its end, and one just beyond it."""
    blade, ball = shapes.box((1.0, 0.05, 0.01)), shapes.sphere(0.01)
    begin = poses(((0, 0, 0), np.eye(3)), (0.49 * np.array([np.cos(angle), np.sin(angle), 0]), np.eye(3)))
    end = begin._replace(R=np.array([about((0, 0, 1), 1.0), np.eye(3)]))
    d = detector(blade, ball)
    hit = d.touches(begin, end, EMPTY)
    (gap,) = d.carried(hit, end, EMPTY)[0].gap
    # The front edge is 0.025 before the middle, the ball 0.01 before its own.
    assert hit.fraction[0] == pytest.approx(angle - 0.035 / 0.49, abs=2e-3)
    assert gap < -0.4 * (1.0 - hit.fraction[0]) * 0.49  # how far the tip went on, along the normal
    begin.x[1] *= 0.525 / 0.49
    assert detector(blade, ball).touches(begin, end, EMPTY).codes.size == 0


@pytest.mark.parametrize("shape", KINDS)
def test_nothing_goes_through_a_thin_wall(shape, rng):
    """1 cm, fixed or moving, from one side to the other within a step; and away from it nothing touches."""
    B = KINDS[shape]
    for _ in range(5):
        Q, R = random_rotation(rng), random_rotation(rng)
        x = np.array([0.2, 0.1, B.bounding_radius + 0.05])
        begin = poses((np.zeros(3), Q), (Q @ x, R))
        end = poses((np.zeros(3), Q), (Q @ (x * [1, 1, -1]), R))
        wall = detector(shapes.box((3.0, 3.0, 0.01)), B)
        found = wall.touches(begin, end, EMPTY)
        normal = wall.carried(found, end, EMPTY)[0].normal
        assert normal.size
        np.testing.assert_allclose(normal, np.broadcast_to(Q[:, 2], normal.shape), rtol=0, atol=1e-4)
        away = poses((np.zeros(3), Q), (Q @ (x + np.array([0, 0, 1])), R))
        assert wall.touches(begin, away, EMPTY).codes.size == 0


def test_what_passes_clear_is_not_reported(rng):
    """Balls at 20 m/s past an obstacle 1 cm clear, in steps of 5 ms, spinning; 1 cm nearer it is hit."""
    ball = shapes.sphere(0.05)
    for obstacle in (shapes.box((0.2, 0.2, 0.2)), shapes.sphere(0.1), shapes.capsule(0.1, 0.2)):
        for clear, count in ((0.01, 0), (-0.01, 1)):
            hits = 0
            for k in range(20):
                x = np.array([-1.0 + 0.1 * k, 0.15 + clear, 0.02])
                begin = poses((np.zeros(3), np.eye(3)), (x, np.eye(3)))
                end = poses((np.zeros(3), np.eye(3)), (x + np.array([0.1, 0, 0]), about((0, 0, 1), rng.uniform(-1, 1))))
                found = detector(obstacle, ball).touches(begin, end, EMPTY)
                hits += found.codes.size > 0
            assert (hits > 0) == bool(count)


def test_halfspace_and_fast_corner():
    """A cube that turns by 1 rad a hair above the ground: an edge hits it."""
    cube = shapes.box((1.0, 1.0, 1.0))
    begin, end = poses(((0, 0, 0.6), np.eye(3))), poses(((0, 0, 0.6), about((1, 0, 0), 1.0)))
    d = detector(GROUND, cube)
    found = d.touches(begin, end, EMPTY)
    assert d.carried(found, end, EMPTY)[0].gap.size == 2
    # Where the edge is below: sin(angle + π/4) √½ = 0.6.
    assert found.fraction[0] == pytest.approx(np.arcsin(0.6 * np.sqrt(2)) - np.pi / 4, abs=1e-3)


def test_a_slanted_halfspace_is_followed(rng):
    """In any direction and at any offset: what stays above it is not, what falls through it is."""
    for _ in range(20):
        n, x = rng.normal(size=3), rng.normal(size=3)
        n /= np.linalg.norm(n)
        d = detector(shapes.halfspace(n, n @ x), shapes.box((0.2, 0.4, 0.6)))
        begin = Placement((x + 0.5 * n)[None], random_rotation(rng)[None], ())
        for down, expected in ((0.1, False), (2.0, True)):
            end = begin._replace(x=begin.x - down * n)
            assert (d.touches(begin, end, EMPTY).codes.size > 0) == expected


def test_gaps_at_the_end_pose(rng):
    """Of a contact found again its own gap there, else that of the whole shapes along its normal."""
    cube = shapes.box((1.0, 1.0, 1.0))
    slope = shapes.halfspace((0.6, 0.0, 0.8), 0.1)
    lift = np.array([0.6, 0.0, 0.8])
    R = about((0, 1, 0), np.arctan2(0.6, 0.8))
    d = detector(slope, cube, cube)
    x = np.array([0.601 * lift, 1.602 * lift])
    c = d.find(x, np.array([R, R]), np.full(2, 5e-3), EMPTY)
    assert len(c.gap) == 8
    tilt = about((0, 1, 0), 0.01) @ R
    end = Placement(x + 1e-3 * lift, np.array([R, tilt]), ())
    found = d.find(*end[:2], np.zeros(2), c)
    gaps = d.gaps(c, found, end)
    again = np.isin(c.key, found.key)
    assert again.any() and not again.all()
    at = {key: gap for key, gap in zip(found.key.tolist(), found.gap.tolist(), strict=True)}
    for k in range(len(c.gap)):
        n = c.normal[k]
        if again[k]:
            assert gaps[k] == at[c.key[k]]
        elif c.geom1[k] == 0:
            assert gaps[k] == pytest.approx(2e-3, abs=1e-12)
        else:
            top = (cube.vertices @ R.T + end.x[0]) @ n
            assert gaps[k] == pytest.approx(((cube.vertices @ tilt.T + end.x[1]) @ n).min() - top.max(), abs=1e-12)
    none = d.gaps(c, EMPTY, end)
    np.testing.assert_allclose(none[c.geom1 == 0], 2e-3, rtol=0, atol=1e-12)


def test_pairs_left_out_and_keys_go_on():
    """Known contacts are not followed; the others continue the keys of the memory, and are remembered."""
    ball = shapes.sphere(0.1)
    d = detector(GROUND, ball, ball)
    begin = poses(((0, 0, 0.1), np.eye(3)), ((0.5, 0, 0.1), np.eye(3)))
    resting = d.find(*begin[:2], np.zeros(2), EMPTY)
    assert resting.key.tolist() == [0, 1]
    end = poses(((0.9, 0, 0.05), np.eye(3)), ((0.5, 0, 0.05), np.eye(3)))
    contacts, memory = d.carried(d.touches(begin, end, resting, lambda: resting), end, resting)
    assert (contacts.geom1.tolist(), contacts.geom2.tolist()) == ([1], [2])
    assert contacts.key.tolist() == [2]
    assert contacts.gap[0] == pytest.approx(-0.6, abs=1e-3)
    again = d.find(*end[:2], np.full(2, 1.0), memory)
    assert again.key.tolist() == [0, 1, 2]
    assert set(d.touches(begin, end, resting).codes.tolist()) >= {3 * 1 + 2, 3 * 0 + 1}


def test_bodies_that_move_together_are_not_followed(monkeypatch, rng):
    """Spinning and flying as one, 1 mm apart: the bound of the relative motion alone tells."""
    box = shapes.box((1.0, 1.0, 1.0))
    x = np.array([[0, 0, 0], [0, 0, 1.001]])
    begin, turn = poses(*((p, np.eye(3)) for p in x)), about((1, 0, 0), 1e-2)
    d = detector(box, box)
    monkeypatch.setattr(d, "_first_touch", lambda *a: pytest.fail("followed"))
    # The chord of the upper one's way is off its arc by 1/8 turn² of the distance, and so is the lower one's.
    end = poses(*((turn @ p + [5, 6, 7], turn) for p in x))
    assert d.touches(begin, end, EMPTY).codes.size == 0


def test_any_rotation_is_found_again(rng):
    """Up to half a turn, and next to it."""
    for angle in (0.0, 1e-9, 1e-4, 0.5, 2.0, 3.1, np.pi - 1e-4, np.pi - 1e-8, np.pi):
        for axis in (*np.eye(3), *rng.normal(size=(20, 3))):
            A, turn = random_rotation(rng), about(axis / np.linalg.norm(axis), angle)
            w = np.array(advancement.turn_between(A[None], (turn @ A)[None], 0))
            assert np.linalg.norm(w) == pytest.approx(angle, abs=1e-8)
            np.testing.assert_allclose(about(w, 1.0), turn, rtol=0, atol=1e-8)


def test_carry_keeps_points_on_their_bodies(rng):
    """Both points of a contact move with their bodies, the normal stays; the world stays too."""
    cube = shapes.box((1.0, 1.0, 1.0))
    d = detector(GROUND, cube, cube)
    begin = poses(((0, 0, 0.501), np.eye(3)), ((0.1, 0.2, 1.502), np.eye(3)))
    c = d.find(*begin[:2], np.full(2, 1e-2), EMPTY)
    end = poses(*((x + rng.normal(size=3), random_rotation(rng)) for x in begin.x))
    moved = carry(c, begin, end)
    for k in range(len(c.gap)):
        p = []
        for f, side in ((c.frame1[k], -0.5), (c.frame2[k], 0.5)):
            a = c.point[k] + side * c.gap[k] * c.normal[k]
            p.append(a if f < 0 else end.x[f] + end.R[f] @ begin.R[f].T @ (a - begin.x[f]))
        np.testing.assert_allclose(moved.point[k], 0.5 * (p[0] + p[1]), rtol=0, atol=1e-14)
        assert moved.gap[k] == pytest.approx(c.normal[k] @ (p[1] - p[0]), abs=1e-14)
    np.testing.assert_array_equal(moved.normal, c.normal)
    np.testing.assert_allclose(carry(c, begin, begin).gap, c.gap, rtol=0, atol=1e-14)


def test_normals_turn_with_the_bodies_they_are_of(rng):
    """Of the face below, of the face above, and of both: back to the z axis, along which the cubes are 1 mm apart."""
    large, small = shapes.box((3.0, 3.0, 1.0)), shapes.box((1.0, 1.0, 1.0))
    corner = about((1.0, 1.0, 0.0), 0.6)
    height = 0.5 - (small.vertices @ corner.T)[:, 2].min() + 1e-3
    turn = about(rng.normal(size=3), 0.1)
    for first, second, R1, R2 in (
        (large, small, turn, np.eye(3)),
        (small, large, np.eye(3), turn),
        (large, small, turn, turn),
    ):
        over = 1.0 if first is large else -1.0
        faces = [np.eye(3) if shape is large else corner for shape in (first, second)]
        begin = poses(((0, 0, 0), faces[0]), ((0, 0, over * height), faces[1]))
        end = poses(((0, 0, 0), R1 @ faces[0]), ((0, 0, over * height), R2 @ faces[1]))
        d = detector(first, second)
        c = d.find(*begin[:2], np.full(2, 1e-2), EMPTY)
        there, apart = d.carry(c, begin, end)
        back, _ = d.carry(there, end, begin)
        own = R1 if first is large else R2
        np.testing.assert_allclose(there.normal, c.normal @ own.T, rtol=0, atol=1e-14)
        np.testing.assert_allclose(back.normal, c.normal, rtol=0, atol=1e-14)
        low, high = (
            (shape.vertices @ R.T + x) @ there.normal[0]
            for shape, R, x in zip((first, second), end.R, end.x, strict=True)
        )
        assert apart == pytest.approx(high.min() - low.max(), abs=1e-14)


def test_what_first_parts_is_hit_later():
    """A ball leaves a plate that turns by φ = 0.9 rad at 1.02 φ, but tan φ > 1.02 φ."""
    plate, ball = shapes.box((4.0, 1.0, 0.1)), shapes.sphere(0.01)
    begin = poses(((0, 0, 0), np.eye(3)), ((1.0, 0.0, 0.06 + 1e-6), np.eye(3)))
    end = poses(((0, 0, 0), about((0, 1, 0), -0.9)), ((1.0, 0.0, 0.06 + 1.02 * 0.9), np.eye(3)))
    touches = detector(plate, ball).touches(begin, end, EMPTY)
    samples = np.array([distance(plate, ball, between(begin, end, s)) for s in np.linspace(0.0, 1.0, 1001)])
    first = np.argmax(samples < 0.0) / 1000
    assert 0.1 < first < 0.5
    assert touches.fraction[0] == pytest.approx(first, abs=2e-3)


def test_what_leaves_what_it_is_in_is_not_hit():
    """A ball that is 1 mm deep in a box, straight out."""
    box, ball = shapes.box((1.0, 1.0, 0.1)), shapes.sphere(0.1)
    begin = poses(((0, 0, 0), np.eye(3)), ((0.0, 0.0, 0.149), np.eye(3)))
    end = begin._replace(x=begin.x + np.array([[0, 0, 0], [0, 0, 0.5]]))
    assert detector(box, ball).touches(begin, end, EMPTY).codes.size == 0


def test_what_touches_is_found_where_it_touches_again():
    """A rod turns away from a ball that it touches by 3 rad, and meets it with its other half after π - 2φ."""
    rod, ball = shapes.box((2.0, 0.02, 0.02)), shapes.sphere(0.1)
    begin = poses(((0, 0, 0), np.eye(3)), ((0.5, 0.11, 0), np.eye(3)))
    d = detector(rod, ball)
    resting = d.find(*begin[:2], np.zeros(2), EMPTY)
    assert resting.gap.size == 1
    back = begin._replace(R=np.array([about((0, 0, 1), -3.0), np.eye(3)]))
    touches = d.touches(begin, back, resting, together=resting)
    # What is nearer than 1e-4 of the ball's radius touches: at 0.5 m/rad, 7e-6 of the way.
    assert touches.fraction[0] == pytest.approx((np.pi - 2.0 * np.arctan2(0.11, 0.5)) / 3.0, abs=1e-5)
    short = begin._replace(R=np.array([about((0, 0, 1), -2.5), np.eye(3)]))
    assert d.touches(begin, short, resting, together=resting).codes.size == 0
    # What does not part is not found, but where it gets deep: it touches all the way, or closes the gap that it has.
    least = np.full(2, 1e-3)
    along = begin._replace(x=begin.x + np.array([[0, 0, 0], [-0.9, -1e-4, 0]]))
    assert d.touches(begin, along, resting, together=resting, least=least).codes.size == 0
    above = begin._replace(x=begin.x + np.array([[0, 0, 0], [0, 1e-3, 0]]))
    assert d.touches(above, along, resting, together=resting, least=least).codes.size == 0
    assert d.touches(above, along, resting).codes.size == 1
    through = begin._replace(x=begin.x + np.array([[0, 0, 0], [0, -0.25, 0]]))
    assert d.touches(begin, through, resting).fraction.tolist() == [0.0]
    # It moves on by as much as it may be deep: 1/250 of the way.
    found = d.touches(begin, through, resting, together=resting, least=least).fraction
    np.testing.assert_allclose(found, [1 / 250], rtol=0, atol=1e-6)
