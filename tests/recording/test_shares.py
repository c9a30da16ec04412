"""What redundant contacts share: least norm by another solver, force, torque, works and law of contact by sums."""

import csv

import clarabel
import numpy as np
import pytest
import scipy.sparse as sp
from matplotlib.figure import Figure

import nsdyn as nd
from nsdyn import cli
from nsdyn.problem import cones
from nsdyn.recording import shares
from nsdyn.view import arrows, contact_points, plots

STICK, SLIP = 1, 2


@pytest.fixture(scope="module")
def sliding():
    """A box that slides until 0.204 s and then stands."""
    return nd.simulate(nd.scenes.load("slide")(speed=1.0), 0.3, dt=1e-2)


@pytest.fixture(scope="module")
def turning():
    """A box that slides while it turns, with a box at rest on it that slides along it."""
    scene = nd.Scene()
    scene.add_halfspace("ground")
    turns = {"linear_velocity": (1, 0.5, 0), "angular_velocity": (0, 0, 3)}
    scene.add_box("below", (0.4, 0.4, 0.2), 2.0, position=(0, 0, 0.1), **turns)
    scene.add_box("above", (0.2, 0.2, 0.2), 1.0, position=(0.05, 0, 0.3))
    return nd.simulate(scene, 0.3, dt=5e-3)


def axes_of(c):
    return np.stack([c["normal"], c["tangent"], np.cross(c["normal"], c["tangent"])], axis=1)


def wrench(c, r):
    """Force and torque about the origin of each impulse, shape (n, 6)."""
    push = np.einsum("ci,cij->cj", r, axes_of(c))
    return np.concatenate([push, np.cross(c["point"], push)], axis=1)


def some_problem(rng):
    """Contacts of two bodies anywhere, on a plane or on a line, some of which slip, with impulses that obey the law."""
    n, kind = rng.integers(2, 9), rng.integers(4)
    point, normal = rng.normal(size=(n, 3)), rng.normal(size=(n, 3))
    if kind == 0:
        point[:, 2], normal = 0.0, np.tile((0.0, 0.0, 1.0), (n, 1))
    if kind == 1:
        point = np.outer(rng.normal(size=n), rng.normal(size=3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    tangent = np.cross(normal, rng.normal(size=(n, 3)))
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    mu = rng.uniform(0.05, 1.0, n)
    status = rng.integers(STICK, SLIP + 1, n).astype(np.int8)
    r = rng.normal(size=(n, 3))
    r[:, 0] = np.abs(r[:, 0])
    r = cones.project(r, mu)
    size = np.hypot(r[:, 1], r[:, 2])
    r[status == SLIP, 1:] *= (mu * r[:, 0] / size)[status == SLIP, None]
    return {
        "point": point,
        "normal": normal,
        "tangent": tangent,
        "mu": mu,
        "status": status,
        "time": np.zeros(n),
        "impulse": r,
    }


def least_norm(c):
    """The smallest Σ ‖r‖² with the same force and torque, in the cones and along the slips, by Clarabel."""
    n, r = len(c["mu"]), c["impulse"]
    own = np.zeros((6, n, 3))
    for k in range(3):
        own[:, :, k] = wrench(c, np.tile(np.eye(3)[k], (n, 1))).T
    own = own.reshape(6, -1)
    rows, right, kinds = [own], [own @ r.ravel()], [clarabel.ZeroConeT(6)]
    for k in range(n):
        of = np.zeros((3, 3 * n))
        of[:, 3 * k : 3 * k + 3] = np.eye(3)
        if c["status"][k] == SLIP:
            along = r[k] / np.linalg.norm(r[k])
            rows += [np.linalg.svd(along[None])[2][1:] @ of, -(along @ of)[None]]
            right += [np.zeros(2), np.zeros(1)]
            kinds += [clarabel.ZeroConeT(2), clarabel.NonnegativeConeT(1)]
        else:
            rows, right = [*rows, -np.diag([c["mu"][k], 1.0, 1.0]) @ of], [*right, np.zeros(3)]
            kinds.append(clarabel.SecondOrderConeT(3))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    cost = sp.eye(3 * n, format="csc")
    A = sp.csc_matrix(np.vstack(rows))
    return np.array(clarabel.DefaultSolver(cost, np.zeros(3 * n), A, np.concatenate(right), kinds, settings).solve().x)


@pytest.mark.slow
def test_norm_is_least(rng):
    less = 0
    for _ in range(150):
        c = some_problem(rng)
        n, r = len(c["mu"]), c["impulse"]
        bodies = np.sort(rng.permutation([3, 8]))
        found = shares.shared(np.tile(bodies, (n, 1)), np.ones(n, np.int64), c)
        off = (wrench(c, found) - wrench(c, r)).sum(axis=0)
        assert np.abs(off).max() <= 1e-11 * np.linalg.norm(r, axis=1).sum()  # 1e-12, and arms of several metres
        assert (np.hypot(found[:, 1], found[:, 2]) <= c["mu"] * found[:, 0] + 1e-14).all()
        slips = c["status"] == SLIP
        np.testing.assert_allclose(np.cross(found, r)[slips], 0.0, rtol=0, atol=1e-14 * np.abs(r).max() ** 2 * n)
        # Clarabel stops at 1e-8.
        best = (least_norm(c) ** 2).sum()
        assert abs((found**2).sum() - best) <= 1e-6 * (r**2).sum()
        less += (found**2).sum() < 0.9 * (r**2).sum()
    assert less > 50


def test_order_of_bodies_does_not_matter(rng):
    """Turned round, normal, t1 and what acts on the other body change their signs, and so r_T2 does."""
    c = some_problem(rng)
    n = len(c["mu"])
    step, back = np.zeros(n, np.int64), (np.arange(n) % 2 == 0)[:, None]
    mirror = np.where(back, (1.0, 1.0, -1.0), 1.0)
    turned = c | {
        "normal": np.where(back, -1.0, 1.0) * c["normal"],
        "tangent": np.where(back, -1.0, 1.0) * c["tangent"],
    }
    turned["impulse"] = mirror * c["impulse"]
    one = shares.shared(np.tile((0, 1), (n, 1)), step, c)
    other = shares.shared(np.where(back, (1, 0), (0, 1)), step, turned)
    np.testing.assert_allclose(mirror * other, one, rtol=0, atol=1e-10)


def test_only_what_acts_together_is_shared(rng):
    """Two contacts on one line whose halves are equal: not of other bodies, steps or times, nor what is open."""
    n = 2
    c = {
        "point": np.array([[0.0, 0, 0], [1, 0, 0]]),
        "normal": np.tile((0.0, 0, 1), (n, 1)),
        "tangent": np.tile((1.0, 0, 0), (n, 1)),
        "mu": np.full(n, 0.5),
        "status": np.full(n, STICK, np.int8),
        "time": np.zeros(n),
        "impulse": np.array([[1.0, 0.3, 0], [1, -0.1, 0]]),
    }
    together, step = np.tile((0, 1), (n, 1)), np.zeros(n, np.int64)
    np.testing.assert_allclose(shares.shared(together, step, c), np.tile((1.0, 0.1, 0), (n, 1)), rtol=0, atol=1e-13)
    apart = [
        (np.array([[0, 1], [0, 2]]), step, c),
        (together, np.array([0, 1]), c),
        (together, step, c | {"time": np.array([0.0, 1e-4])}),
        (
            together,
            step,
            c | {"impulse": np.array([[1.0, 0.3, 0], [0, 0, 0]]), "status": np.array([STICK, 0], np.int8)},
        ),
    ]
    for given in apart:
        np.testing.assert_array_equal(shares.shared(*given), given[2]["impulse"])


def test_where_nothing_is_found_the_solvers_impulses_stay():
    """What is no number is none of least norm: recordings of it open."""
    c = {
        "point": np.zeros((2, 3)),
        "normal": np.tile((0.0, 0, 1), (2, 1)),
        "tangent": np.tile((1.0, 0, 0), (2, 1)),
        "mu": np.full(2, 0.5),
        "status": np.full(2, STICK, np.int8),
        "time": np.zeros(2),
        "impulse": np.array([[1.0, 0.3, 0], [1, np.nan, 0]]),
    }
    found = shares.shared(np.tile((0, 1), (2, 1)), np.zeros(2, np.int64), c)
    np.testing.assert_array_equal(found, c["impulse"])


def test_a_box_at_rest_shows_no_friction(sliding):
    """The solver's corners pull at each other; each carries a quarter of the weight, and nothing more."""
    last = sliding.contacts(-1)
    raw = np.hypot(*last.impulse_raw[:, 1:].T)
    assert (raw > 0.1 * last.mu * last.impulse_raw[:, 0]).all()
    # To the solver's 1e-8 m/s of 1 kg.
    np.testing.assert_allclose(last.impulse, np.tile((9.81e-2 / 4, 0, 0), (4, 1)), rtol=0, atol=1e-8)


@pytest.mark.parametrize("name", ["sliding", "turning"])
def test_bodies_feel_the_same(name, request):
    """Force, torque, works at the relative velocities, and the law of contact."""
    trajectory = request.getfixturevalue(name)
    slips = changed = 0
    for k in range(1, trajectory.steps + 1):
        table = trajectory.contacts(k)
        c = {column: getattr(table, column) for column in ("point", "normal", "tangent")}
        raw, r, u = table.impulse_raw, table.impulse, table.u
        size = np.linalg.norm(raw, axis=1).sum()
        pairs = list(zip(table.body1, table.body2, strict=True))
        for pair in set(pairs):
            mine = np.array([p == pair for p in pairs])
            off = (wrench(c, r) - wrench(c, raw))[mine].sum(axis=0)
            np.testing.assert_allclose(off, 0.0, rtol=0, atol=1e-12 * size)
            # u of one pair are those of one relative motion, but for the drift of the rows, of second order.
            works = [(u * x)[mine].sum() for x in (r, raw)]
            assert works[0] == pytest.approx(works[1], rel=1e-3, abs=1e-7 * size)
        assert (np.hypot(r[:, 1], r[:, 2]) <= table.mu * r[:, 0] * (1 + 1e-9) + 1e-15).all()
        slip = table.status == SLIP
        np.testing.assert_allclose(np.hypot(*r[slip, 1:].T), (table.mu * r[:, 0])[slip], rtol=1e-9, atol=1e-15)
        assert ((raw[slip, 1:] * r[slip, 1:]).sum(axis=1) >= 0.0).all()
        assert not r[table.status == 0].any()
        slips += slip.sum()
        changed += np.abs(r - raw).max() > 1e-3 * size
    assert slips > 50 and changed > 0


def test_all_show_the_same(sliding, tmp_path):
    """Table of a step, table of all, CSV, the page's contacts and arrows, the plot of cones; `pair` is their sum."""
    k = sliding.steps
    last = sliding.contacts(k)
    world = last.impulse_world
    table = sliding.table("contacts")
    rows = np.flatnonzero(np.asarray(table["step"]) == k)
    for name, values in (("impulse", world), ("impulse_raw", last.impulse_raw)):
        given = np.column_stack([np.asarray(table[f"{name}_{axis}"])[rows] for axis in "xyz"])
        if name == "impulse_raw":  # to the axes of the world
            c = {column: getattr(last, column) for column in ("normal", "tangent")}
            values = np.einsum("ci,cij->cj", values, axes_of(c))
        np.testing.assert_allclose(given, values, rtol=0, atol=1e-15)
    drag = np.hypot(*last.impulse[:, 1:].T)
    np.testing.assert_allclose(np.asarray(table["impulse_T"])[rows], drag, rtol=0, atol=1e-15)
    page = contact_points.at(sliding, np.array([0, k]))
    order = [np.lexsort(x["point"].T if isinstance(x, dict) else x.point.T) for x in (page, last)]
    np.testing.assert_allclose(page["r"][order[0]][:, 0], last.impulse[order[1]][:, 0], rtol=0, atol=1e-15)
    np.testing.assert_allclose(page["r"][:, 1:], 0.0, rtol=0, atol=1e-8)
    assert (page["state"] == STICK).all()  # none at the edge
    drawn = arrows.between(sliding, np.array([k - 1, k]), "point").force
    np.testing.assert_allclose(drawn, np.tile(world.mean(axis=0) / sliding.dt, (4, 1)), rtol=0, atol=1e-6)
    pair = sliding.pair("ground", "box")
    np.testing.assert_allclose(world.sum(axis=0) / sliding.dt, pair.force[-1], rtol=0, atol=1e-10)
    np.testing.assert_allclose(pair.force[-1], sliding.force("box")[-1], rtol=0, atol=1e-12)
    sticks = plots.draw(sliding, "friction", figure=Figure()).axes[0].lines[0].get_ydata()
    drags = table["impulse_T"][table["state"] == "stick"] / sliding.dt
    np.testing.assert_allclose(sticks, drags, rtol=0, atol=1e-12)
    sliding.save(tmp_path / "run.h5")
    assert cli.main(["contacts", str(tmp_path / "run.h5"), "--csv", str(tmp_path / "c.csv")]) == 0
    head, *lines = csv.reader((tmp_path / "c.csv").read_text().splitlines())
    force = [float(line[head.index("impulse_T [N s]")]) for line in lines if int(line[head.index("step")]) == k]
    np.testing.assert_allclose(force, 0.0, rtol=0, atol=1e-8)
