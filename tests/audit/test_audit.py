"""The audit passes motions as they are and catches every falsification, naming the step and the bodies."""

import dataclasses
import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import nsdyn as nd
from nsdyn.audit import touching
from nsdyn.audit.articulated import FINDINGS
from nsdyn.audit.audit import deepest
from nsdyn.audit.findings import TOLERANCES
from nsdyn.audit.flight import Flight, tumbled
from nsdyn.audit.poses import Poses
from nsdyn.stepping import substepping

ARTICULATED = {*FINDINGS}
"""Findings of articulations alone."""

UNSEEN = "certificates", "provenance"
"""What no motion shows."""

PASSED = "passed, not audited: certificates, provenance"

K = 30
"""A step in which the box slides and the ball rests on it."""


def scene():
    out = nd.Scene(name="ball on box")
    out.add_halfspace("ground", material=nd.Material(mu=0.4))
    out.add_box("box", (0.2, 0.2, 0.1), 1.0, position=(0, 0, 0.05), linear_velocity=(1, 0.3, 0))
    out.add_sphere("ball", 0.05, 0.3, position=(0, 0, 0.15), linear_velocity=(1, 0.3, 0))
    out.add_cylinder("can", 0.05, 0.1, 0.2, position=(0.5, 0, 0.05))
    return out


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    path = tmp_path_factory.mktemp("audit") / "run.h5"
    nd.simulate(scene(), duration=0.06, dt=1e-3, record=path)
    return path


@pytest.fixture
def trajectory(recording):
    return nd.Trajectory.load(recording)


def rows(trajectory, *bodies, step=K):
    """Rows of the contacts of two bodies in a step."""
    table, offset = trajectory.contacts(step), trajectory.columns["contacts/offset"][step - 1]
    some = [k for k in range(len(table)) if {table.body1[k], table.body2[k]} == set(bodies)]
    assert some
    return offset + np.array(some)


def test_a_run_passes(trajectory):
    audit = nd.check(trajectory)
    assert audit.passed, audit
    assert {f.name for f in audit.findings} == TOLERANCES.keys() - ARTICULATED - {"frames", "prescribed"}
    assert audit.not_audited == UNSEEN and all(f.looked_at for f in audit.findings if not f.reason)
    # Momentum and energy are conserved to round-off, and nothing overlaps beyond it.
    assert max(audit[name].worst for name in ("momentum", "spin", "energy", "works", "balance", "cone")) < 1e-13
    assert audit["overlap"].worst < 1e-9
    plain = json.loads(json.dumps(audit.as_dict()))
    assert plain["passed"] is True and plain["findings"]["spin"]["tol"] == TOLERANCES["spin"]
    assert repr(audit).splitlines()[-1] == f"ball on box: {PASSED}"


def failed(trajectory, name, step, *bodies):
    """The finding, which must fail and name the step and the bodies."""
    audit = nd.check(trajectory)
    finding = audit[name]
    assert not audit.passed and not finding.passed, audit
    assert finding.step == step and set(finding.bodies) == set(bodies), audit
    assert "FAILED" in repr(audit).splitlines()[-1]
    return finding


def test_columns_are_below_each_other():
    setup = nd.scenes.setup("arm_pushes_box")  # of articulations, whose findings have the longest names
    head, *lines = repr(nd.check(nd.simulate(setup.scene, 0.05, **setup.options(dt=1e-2)))).splitlines()
    assert {line.index("passed") for line in lines[:-1] if " passed " in line} == {head.index("tolerance") + 11}


def test_overlap(trajectory):
    """A millionth of the size is caught, and measured."""
    x = trajectory.q[K, 2]
    trajectory.q[K, 2] = x - 1e-7  # of the box, 0.1 m high, into the ground
    finding = failed(trajectory, "overlap", K, "box", "ground")
    assert finding.worst == pytest.approx(1e-6, rel=0.01) and finding.amount == pytest.approx(1e-7, rel=0.01)
    trajectory.q[K, 2] = x
    trajectory.q[K, 7 + 2] -= 1e-7
    assert failed(trajectory, "overlap", K, "ball", "box").worst == pytest.approx(1e-6, rel=0.01)
    trajectory.q[K, 7 + 2] += 1e-7
    trajectory.q[K, 14 + 2] -= 1e-7
    failed(trajectory, "overlap", K, "can", "ground")


@pytest.mark.parametrize(
    ("column", "change", "name", "bodies"),
    [
        ("contacts/impulse", lambda r: r * (1.0 + 1e-6), "momentum", ("can", "ground")),
        ("contacts/impulse", lambda r: r * (-1.0, 1.0, 1.0), "cone", ("ball", "box")),
        ("contacts/impulse", lambda r: r * (1.0, 1.0 + 1e-6, 1.0 + 1e-6), "cone", ("box", "ground")),
        ("contacts/impulse", lambda r: r * (1.0, -1.0, -1.0), "friction", ("box", "ground")),
        ("contacts/point", lambda x: np.add(x, (0.01, 0.0, 0.0)), "spin", ("box", "ground")),
        ("contacts/work_friction", lambda w: 0.9 * w, "contact_works", ("box", "ground")),
        ("energy/kinetic", lambda e: e * (1.0 + 1e-6), "energy", ()),
        ("energy/friction", lambda w: w * (1.0 + 1e-6), "balance", ()),
    ],
    ids=["scaled", "sucking", "outside of its cone", "driving", "elsewhere", "hidden work", "energy", "ledger"],
)
def test_one_value(trajectory, column, change, name, bodies):
    """Of one contact, or of one step: the finding names the step and the bodies, for sums over a body that alone."""
    row = rows(trajectory, *bodies)[0] if bodies else K if name == "energy" else K - 1
    values = trajectory.columns[column]
    values[row] = change(values[row])
    failed(trajectory, name, K, *(bodies[:1] if name in ("momentum", "spin") else bodies))


def test_coefficients_are_those_of_the_materials(tmp_path):
    """By the scene's rules, or as set of two bodies; what is not recorded is not audited."""
    scene = nd.Scene(friction_rule="min", restitution_rule="average")
    scene.add_halfspace("ground", material=nd.Material(0.9, 0.2))
    for k, name in enumerate("ab"):
        scene.add_sphere(name, 0.1, 1.0, position=(k, 0, 0.1), linear_velocity=(1, 0, 0))
    scene.set_pair("ground", "b", mu=0.11)
    nd.simulate(scene, 0.03, 1e-2).save(tmp_path / "t.h5")
    trajectory = nd.Trajectory.load(tmp_path / "t.h5")
    finding = nd.check(trajectory)["materials"]
    assert finding.worst == 0.0 and finding.looked_at == 6
    row = int(np.flatnonzero(trajectory.columns["contacts/mu"] == 0.11)[0])
    trajectory.columns["contacts/mu"][row] = 0.5
    assert failed(trajectory, "materials", 1, "b", "ground").worst == pytest.approx(0.39)
    trajectory.columns["contacts/mu"][row] = 0.11
    trajectory.columns["contacts/restitution"][row] = 0.0
    assert failed(trajectory, "materials", 1, "b", "ground").worst == pytest.approx(0.1)
    trajectory.scene["friction_rule"] = "mean"
    trajectory.save(tmp_path / "of_no_rule.h5")
    with pytest.raises(ValueError, match="unknown friction_rule 'mean'"):
        nd.Trajectory.load(tmp_path / "of_no_rule.h5")


@pytest.mark.parametrize(("size", "passes"), [(1e-16, True), (1e-12, False)])
def test_impulses_that_are_round_off(size, passes):
    """What is left of the impulses where all bodies part is as small as round-off of their momenta, 2 N·s here."""
    sliding = nd.simulate(nd.scenes.load("slide")(), 0.02, dt=5e-3)
    sliding.columns["contacts/impulse"][:4] = 0.0, size, 0.0
    assert nd.check(sliding)["cone"].passed is passes


def test_turned_normal(trajectory):
    normal = trajectory.columns["contacts/normal"]
    for bodies in (("box", "ground"), ("ball", "box")):
        row = rows(trajectory, *bodies)[0]
        old = normal[row].copy()
        normal[row] = Rotation.from_rotvec([0.05, 0.0, 0.0]).apply(old)
        failed(trajectory, "normal", K, *bodies)
        normal[row] = old


def test_changed_velocity(trajectory):
    trajectory.v[K, 14] += 1e-6
    assert nd.check(trajectory)["momentum"].bodies == ("can",)
    # The steps that end and that begin there are off by the same, but for round-off.
    failed(trajectory, "momentum", nd.check(trajectory)["momentum"].step, "can")
    assert nd.check(trajectory)["momentum"].step in (K, K + 1)


def test_contact_point_off_the_bodies(trajectory):
    """A millimetre above the ground, along the impulse, which turns the can as it did."""
    row = rows(trajectory, "can", "ground")[0]
    trajectory.columns["contacts/point"][row, 2] += 1e-3
    assert failed(trajectory, "points", K, "can", "ground").amount == pytest.approx(1e-3, rel=0.01)
    assert nd.check(trajectory)["spin"].passed


def test_impulse_at_a_distance(trajectory):
    """The can floats a millimetre above the ground, always."""
    trajectory.q[:, 14 + 2] += 1e-3
    finding = nd.check(trajectory)["distance"]
    assert not finding.passed and set(finding.bodies) == {"can", "ground"}
    assert finding.amount == pytest.approx(1e-3, rel=0.01)


def test_jump(trajectory):
    trajectory.q[K:, 14] += 0.05
    failed(trajectory, "motion", K, "can")


def test_contacts_that_create_energy(trajectory):
    trajectory.columns["contacts/work_normal"][rows(trajectory, "box", "ground")] = 0.1
    failed(trajectory, "contact_works", K, "box", "ground")
    trajectory.energy.friction[K - 1] += 0.1  # what contacts that stay closed do is booked as numerics
    failed(trajectory, "dissipation", K)


def test_energy_that_numerics_take(trajectory):
    """Until the step, by no more than a little in each: a ledger that balances may lose a motion all the same."""
    worst = nd.check(trajectory)["numerics"].worst
    trajectory.energy.integration[:K] -= trajectory.at_play
    finding = failed(trajectory, "numerics", K)
    assert worst < 1e-6 and nd.check(trajectory, numerics=2.0 * finding.worst)["numerics"].passed


def test_not_a_number_fails(trajectory):
    trajectory.v[K, 14] = np.nan
    audit = nd.check(trajectory)
    assert not audit["momentum"].passed and not audit.passed


@pytest.mark.parametrize("name", ["v", "contacts/impulse"])
def test_an_audit_of_absurd_numbers_ends(name, trajectory):
    trajectory.columns[name] = trajectory.columns[name].copy()
    trajectory.columns[name][3] = 1e200
    assert not nd.check(trajectory).passed


def test_tolerances(trajectory):
    assert not nd.check(trajectory, overlap=-1.0).passed
    with pytest.raises(ValueError, match=r"tolerance must be one of .*; got 'gap'"):
        nd.check(trajectory, gap=1.0)


def pushes():
    """A box that sticks and slips to and fro, and a drone that nothing else touches."""
    scene, material = nd.Scene(), nd.Material(mu=0.6)
    scene.add_halfspace("ground", material=material)
    scene.add_box("box", (0.2, 0.3, 0.1), 1.0, position=(0, 0, 0.05), material=material)
    scene.add_box("drone", (0.2, 0.3, 0.1), 1.0, position=(0, 2, 1))

    def force(t, q, v):
        return {
            "box": (12 * np.cos(7 * t), 3 * np.sin(5 * t), 0),
            "drone": ((0, 0, 9.0 - v[8]), (0.002, 0.004 - 0.01 * v[10], 0.001)),
        }

    return nd.simulate(scene, 0.8, 2e-2, external_force=force)


def test_external_forces_push_in_every_move_of_a_step():
    """Where slip turns round a step is cut, and a force that changes is another in each of its moves."""
    pushed = pushes()
    c = pushed.columns
    box = c["wrenches/body"] == 0
    assert (c["wrenches/duration"][box] < 0.02).any()
    audit = nd.check(pushed)
    assert audit.passed and audit.not_audited == UNSEEN, audit
    assert max(audit["momentum"].worst, audit["spin"].worst) < 1e-13

    def found(group="wrenches", **other):
        columns = c | {f"{group}/{name}": values for name, values in other.items()}
        return {f.name for f in nd.check(nd.Trajectory(pushed.meta, pushed.scene, columns)).findings if not f.passed}

    assert "momentum" in found(impulse=np.where(box[:, None], 1.0 + 1e-6, 1.0) * c["wrenches/impulse"])
    assert {"momentum", "spin"} <= found(body=1 - c["wrenches/body"])
    first = np.flatnonzero(box & (c["wrenches/duration"] < 0.02))[:2]
    moved = c["wrenches/impulse"].copy()
    moved[first, 0] += 1e-4, -1e-4
    assert {"velocities", "lifts"} <= found(impulse=moved)  # of which the sum is the same
    assert "contact_works" in found("contacts", work_friction=1.01 * c["contacts/work_friction"])
    for name in ("time", "duration"):
        assert "times" in found(**{name: 1.0001 * c[f"wrenches/{name}"]})


def test_links(tmp_path):
    """Overlaps of links with the world and each other count, unless a joint joins them."""
    robot = nd.Scene()
    robot.add_halfspace("ground")
    robot.add_urdf("arm", nd.scenes.folder() / "arm.urdf")
    swing = nd.simulate(robot, duration=0.02)
    assert swing.scene["excluded"]
    assert nd.check(swing)["overlap"].passed
    link = swing.scene["frames"][-1]
    swing.columns["frames/x"][5, -1, 2] -= 3.0
    finding = nd.check(swing)["overlap"]
    assert finding.step == 5 and "ground" in finding.bodies and any(link.split("/")[0] in b for b in finding.bodies)


def test_deepest():
    pile = nd.Scene()
    pile.add_halfspace("ground")
    for k in range(3):
        pile.add_sphere(f"ball{k}", 0.1 * (k + 1), 1.0)
    q = np.zeros((4, 3, 7))
    q[..., 6] = 1.0
    q[:, :, 2] = 1.0, 2.0, 3.0
    assert deepest(pile.describe(), q.reshape(4, -1)) == 0.0
    q[2, 0, 2] = 0.09
    q[3, 1, :3] = 0.0, 0.48, 3.0
    assert deepest(pile.describe(), q.reshape(4, -1)) == pytest.approx(0.02)


@pytest.mark.slow
def test_only_neighbours_of_a_large_recording_are_compared(monkeypatch):
    """A hundred bodies that touch, of 4950 pairs: at most those that share a face, an edge or a corner."""
    compared, real = [], touching.separation

    def separation(a, R1, x1, b, R2, x2, exact=False):
        compared.append(len(x1))
        return real(a, R1, x1, b, R2, x2, exact=exact)

    monkeypatch.setattr(touching, "separation", separation)
    rng = np.random.default_rng(0)
    crowd = nd.Scene()
    crowd.add_halfspace("ground")
    for k in range(100):
        crowd.add_box(f"box{k}", (0.1, 0.1, 0.1), 1.0)
    q = np.zeros((200, 100, 7))
    grid = np.stack(np.meshgrid(*[np.arange(5)] * 3), axis=-1).reshape(-1, 3)[:100]
    q[..., :3] = 0.1 * grid + [0.0, 0.0, 0.05]
    q[..., 3:] = Rotation.from_rotvec([0.0, 0.0, 1e-9] * rng.normal(size=(100, 1))).as_quat()
    assert deepest(crowd.describe(), q.reshape(200, -1)) < 1e-9
    assert 0 < sum(compared) <= 200 * 100 * (26 / 2 + 1)  # and the ground


@pytest.mark.slow
def test_bodies_that_the_scene_squeezes_are_not_the_motions_overlap():
    """Every step says OVERLAP; deeper than at the start, or where a step says that it is clear, it fails."""
    trajectory = nd.simulate(nd.scenes.load("peg")(), 5e-3, dt=1e-3)
    assert (trajectory.solver.status == nd.Status.OVERLAP).all()
    assert nd.check(trajectory).passed
    trajectory.q[3, 0] += 1e-6
    finding = nd.check(trajectory)["overlap"]
    assert not finding.passed and finding.step == 3 and finding.amount == pytest.approx(1e-6, rel=1e-6)
    trajectory.q[3, 0] -= 1e-6
    trajectory.columns["solver/status"][1] = nd.Status.CONVERGED
    finding = nd.check(trajectory)["overlap"]
    assert not finding.passed and finding.step == 2 and finding.amount == pytest.approx(4e-8, rel=1e-6)


def test_contacts_of_grains_sink_by_what_the_solver_leaves():
    """Boxes of 0.1 mm, of which that is more than passes of larger ones; what a recording tells hides no more."""
    scene, turned = nd.Scene(gravity=(0, 0, -9.81e-3)), np.array((0.5, 0.0, 0.7, 0.5))
    scene.add_halfspace("ground", material=nd.Material(mu=0.3))
    for k in range(3):
        at, turn = np.array((0.1 * k, 0.05 * k, 1 + 1.3 * k)), turned / np.linalg.norm(turned)
        scene.add_box(f"grain{k}", (1e-4, 7e-5, 6e-5), 1e-6, position=1e-4 * at, quaternion=turn)
    run = nd.simulate(scene, 0.6, 5e-3)
    overlap = nd.check(run)["overlap"]
    assert overlap.passed and 1e-7 * 6e-5 < overlap.amount < 5e-11, overlap
    run.q[-1, 2] -= 1e-10
    assert not nd.check(run)["overlap"].passed
    run.q[-1, 2] -= 1e-7
    run.meta["solver"] = "Auto(tol=1.0)"
    assert not nd.check(run)["overlap"].passed


@pytest.mark.parametrize("impact", [pytest.param("poisson", marks=pytest.mark.slow), "fremond"])
def test_friction_of_what_rebounds_opposes_the_slip_of_each_impact(impact):
    """Not that of the end: a ball on another one, both with spin, fall on a plane that is rough."""
    scene, material = nd.Scene(), nd.Material(mu=0.4, restitution=0.5)
    scene.add_halfspace("ground", material=material)
    for name, height, spin in (("one", 0.06, 20.0), ("two", 0.16, -30.0)):
        at, turning = (0.01 * height, 0, height), (0, spin, 5.0)
        scene.add_sphere(name, 0.05, 1.0, position=at, angular_velocity=turning, material=material)
    audit = nd.check(nd.simulate(scene, 0.3, dt=5e-3, impact=impact))
    assert audit.passed, audit


def test_friction_of_fremonds_law_opposes_the_mean_slip_of_what_does_not_rebound_too():
    """A box that slides is stopped, and more, where a ball strikes it; it does not bounce on the ground."""
    scene, rough = nd.Scene(), nd.Material(mu=0.9)
    scene.add_halfspace("ground", material=rough)
    scene.add_box("box", (0.2, 0.2, 0.2), 1.0, position=(0, 0, 0.1), linear_velocity=(0.3, 0, -1), material=rough)
    scene.add_sphere("ball", 0.05, 1.0, position=(0, 0, 0.3), linear_velocity=(0, 0, -3), material=rough)
    scene.set_pair("box", "ball", restitution=0.6)
    run = nd.simulate(scene, 0.1, dt=5e-3, impact="fremond")
    assert nd.check(run).passed, nd.check(run)
    run.meta["impact"] = "Newton()"  # which has no friction that drives
    assert not nd.check(run)["friction"].passed


def test_friction_of_fremonds_law_is_not_audited_where_the_mean_slip_is_not_known():
    """A box that strikes a belt and sticks drives it on: its slip turns round."""
    scene = nd.Scene()
    scene.add_box("belt", (2, 2, 0.2), position=(0, 0, -0.1), fixed=True)
    scene.set_motion("belt", surface_velocity=(0.3, 0, 0))
    scene.add_box("box", (0.2, 0.2, 0.2), 1.0, position=(0, 0, 0.12), linear_velocity=(0.1, 0, -1))
    audit = nd.check(nd.simulate(scene, 0.05, 5e-3, impact="fremond"))
    assert audit.passed, audit


@pytest.mark.parametrize("seed", [60, 72])
def test_friction_of_captured_impacts_is_not_audited_where_their_slip_is_not_known(seed, monkeypatch):
    """One box strikes another on a belt, with no impact located: friction opposes the slip of each, not the last."""
    monkeypatch.setattr(substepping, "OPTIONS", dataclasses.replace(substepping.OPTIONS, work=1))
    rng, scene, own = np.random.default_rng(seed), nd.Scene(), {"material": nd.Material(1.0, 0.3)}
    scene.add_box("belt", (4, 4, 0.2), fixed=True, position=(0, 0, -0.1), **own)
    scene.set_motion("belt", surface_velocity=(0.5, 0, 0))
    for name, position, speed in (("low", (0, 0, 0.2), 1.5), ("high", (0.02, 0.01, 0.5), 4.0)):
        q = rng.normal(size=4)
        how = {"position": position, "quaternion": q / np.linalg.norm(q), "linear_velocity": (0, 0, -speed), **own}
        scene.add_box(name, (0.2, 0.15, 0.1), 1.0, angular_velocity=5.0 * rng.normal(size=3), **how)
    audit = nd.check(nd.simulate(scene, 0.3, 5e-3))
    assert audit.passed, audit


@pytest.mark.parametrize("height", [0.1, 0.12])
def test_friction_of_fremonds_law_is_audited_as_well_as_the_mean_slip_is_known(height):
    """With theta = 1 in a step that is cut: a capsule that sticks where it strikes, so that its slip turns round."""
    scene, rough = nd.Scene(), nd.Material(mu=0.7)
    scene.add_halfspace("ground", material=rough)
    how = {"quaternion": (0.64, 0.48, 0.36, 0.48), "angular_velocity": (0, 8, 4), "material": rough}
    scene.add_capsule("capsule", 0.02, 0.06, 1.0, position=(0, 0, height), **how)
    run = nd.simulate(scene, 0.3, 1e-2, theta=1.0, impact="fremond")
    assert nd.check(run).passed, nd.check(run)
    run.columns["contacts/impulse"][:, 1:] *= -1.0
    assert not nd.check(run)["friction"].passed


def test_what_rests_near_its_limit_is_pushed_where_its_contacts_were_found():
    """A cylinder of 1 mm creeps by 2e-12 m and keeps them: what counts as closed is 5e-11 m."""
    scene, rough, turn = nd.Scene(), nd.Material(mu=2.0), Rotation.from_euler("zx", [0.3, np.arctan(0.5 * 0.99)])
    up = turn.apply((0, 0, 1))
    scene.add_halfspace("slope", normal=up, material=rough)
    scene.add_cylinder("cylinder", 5e-4, 2e-3, 1.0, position=1e-3 * up, quaternion=turn.as_quat(), material=rough)
    run = nd.simulate(scene, 0.3, 5e-3)
    assert nd.check(run).passed, nd.check(run)
    run.columns["contacts/point"] += 1e-10 * up[[1, 2, 0]]
    assert not nd.check(run)["spin"].passed


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("place", [1e7, 1e8])
def test_a_box_that_falls_far_away_passes(place):
    """Its places are rounded to 2e-9 and 1.5e-8 m, and contacts are closed no better; larger overlaps are told."""
    scene, turn = nd.Scene(), np.array((0.5, 0.2, 0.7, 0.5)) / np.sqrt(1.03)
    scene.add_halfspace("ground", offset=place)
    at = (place, -place, place + 0.3)
    scene.add_box("box", (0.1, 0.2, 0.15), 1.0, position=at, quaternion=turn, linear_velocity=(1, 0, 0))
    run = nd.simulate(scene, 0.6, dt=5e-3)
    audit = nd.check(run)
    assert audit.passed and run.contacts(-1).impulse.any(), audit
    run.q[-1, 2] -= 1e-6
    assert not nd.check(run)["overlap"].passed


def test_corners_at_any_speed():
    """A box at 20 km/s beside another: its corners have no radius by which the square of that could be divided."""
    scene = nd.Scene(gravity=(0, 0, 0))
    scene.add_box("wall", (1, 1, 1), fixed=True)
    scene.add_box("box", (0.1, 0.1, 0.1), 1.0, position=(0.55, 0, 0), linear_velocity=(-1, 2e4, 0))
    audit = nd.check(nd.simulate(scene, 1e-5, 1e-6))
    assert audit.passed, audit


def bounces():
    """A ball with spin that bounces on a rough plane, between the ends of steps."""
    scene, material = nd.Scene(), nd.Material(mu=0.2, restitution=0.5)
    scene.add_halfspace("ground", material=material)
    scene.add_sphere(
        "ball",
        0.05,
        1.0,
        position=(0, 0, 0.08),
        linear_velocity=(1, 0, 0),
        angular_velocity=(0, -30, 5),
        material=material,
    )
    return nd.simulate(scene, 0.3, dt=5e-3)


def test_impulses_are_audited_where_the_body_is_when_they_act():
    """Free fall ends at sqrt(2 · 0.03 / 9.81) s; another lever or another time is found."""
    trajectory, fall = bounces(), np.sqrt(0.06 / 9.81)
    impulse, time = (trajectory.columns[f"contacts/{name}"] for name in ("impulse", "time"))
    row = int(np.flatnonzero(impulse[:, 0] > 0.0)[0])
    step = int(np.searchsorted(trajectory.columns["contacts/offset"], row, side="right"))
    assert trajectory.t[step - 1] + time[row] == pytest.approx(fall, rel=1e-12)
    audit = nd.check(trajectory)
    # Round-off, and a few times the 1e-11 m by which a ball that counts as closed is lifted.
    assert audit.passed and audit["spin"].worst < 1e-9 and audit["motion"].worst < 1e-6
    trajectory.columns["contacts/point"][row, 0] += 1e-3
    failed(trajectory, "spin", step, "ball")
    trajectory.columns["contacts/point"][row, 0] -= 1e-3
    time[row] += 2e-3
    assert nd.check(trajectory)["motion"].amount == pytest.approx(2e-3 * np.linalg.norm(impulse[row]), rel=0.02)


SETTLING = {
    "box": lambda s, **how: s.add_box("body", (0.2, 0.2, 0.2), 1.0, **how),
    "plate": lambda s, **how: s.add_box("body", (0.3, 0.2, 0.04), 1.0, **how),
    "capsule": lambda s, **how: s.add_capsule("body", 0.08, 0.2, 1.0, **how),
    "cylinder": lambda s, **how: s.add_cylinder("body", 0.1, 0.12, 1.0, **how),
    "ellipsoid": lambda s, **how: s.add_ellipsoid("body", (0.1, 0.08, 0.06), 1.0, **how),
}


def test_a_grain_that_a_heavy_block_pushes_passes():
    """What pushes a gram is not lost in round-off of what pushes a ton."""
    scene, material = nd.Scene(), nd.Material(mu=0.5)
    scene.add_halfspace("ground", material=material)
    scene.add_box("grain", (1e-3, 1e-3, 1e-3), 1e-3, position=(1.5, 0, 5e-4), material=material)
    how = {"position": (7, 0, 0.5), "linear_velocity": (-3, 0, 0), "material": material}
    scene.add_box("block", (10, 2, 1), 1e3, **how)
    found = nd.check(nd.simulate(scene, 1.2, 1e-2))["spin"]
    assert found.worst <= 1e-12, found


def test_what_strikes_and_slides_with_theta_1_passes():
    """The move after an impact acts at the time of that, at another spin."""
    rod = nd.scenes.load("rod")(angle=20.0, mu=1.0, slip=-1.0, fall=0.5)
    audit = nd.check(nd.simulate(rod, 0.01, 2e-3, theta=1.0))
    assert audit.passed, audit


def test_a_hull_of_rounded_corners_passes():
    """Corners of float32 meshes are off the planes of their faces by 1e-8 of their size."""
    scene, corners = nd.Scene(), 0.2 * np.array(list(np.ndindex(2, 2, 2)))
    scene.add_convex("hull", Rotation.from_euler("xyz", (0.3, 0.5, 0.7)).apply(corners).astype(np.float32), 1.0)
    run = nd.simulate(scene, 0.02, 1e-2)
    assert [len(face) for face in run.scene["geoms"][0]["faces"]] == [4] * 6
    found = nd.check(run)["scene"]
    assert found.passed, found


def thin_coin(turning, mu=1.0, thickness=1.5e-4):
    """A coin of 30 cm that stands on its rim and turns about a diameter."""
    scene, material, tilt, r, h = nd.Scene(), nd.Material(mu=mu), np.radians(20.0), 0.15, thickness
    scene.add_halfspace("ground", material=material)
    how = {"quaternion": Rotation.from_euler("x", tilt).as_quat(), "material": material}
    how |= {"position": (0, 0, r * np.sin(tilt) + 0.5 * h * np.cos(tilt)), "angular_velocity": (0, turning, 0)}
    scene.add_cylinder("coin", r, h, 1.0, **how)
    return scene


def test_lifts_of_many_moves_of_a_thin_coin_are_measured_by_what_it_moves():
    """A tenth of its thickness, 10 µm, is the limit of each; all of a step, in which its rim moves 2 cm, are more."""
    run = nd.simulate(thin_coin(60.0, 0.1, 1e-5), 0.04, 1e-2)
    shift, turn = np.linalg.norm(run.columns["lifts/shift"].reshape(-1, 2, 3), axis=2).T
    of_steps = np.bincount(np.repeat(np.arange(4), np.diff(run.columns["lifts/offset"])), shift + 0.15 * turn)
    assert of_steps.max() > 1e-6 and nd.check(run).passed, nd.check(run)
    run.columns["lifts/shift"] *= 1000.0
    assert not nd.check(run)["motion"].passed


def test_many_small_lifts_are_no_motion():
    """A box at rest, said to be lifted by a fifth of itself in a step, in a hundred moves."""
    scene = nd.Scene()
    scene.add_halfspace("ground")
    scene.add_box("box", (1, 1, 1), 1.0, position=(0, 0, 0.5))
    run, n = nd.simulate(scene, 0.05, 1e-2), 100
    run.q[3:, 2] += 0.2
    run.columns.update(
        {
            "lifts/offset": np.array([0, 0, 0, n, n, n]),
            "lifts/body": np.zeros(n, int),
            "lifts/time": np.linspace(0.0, 1e-2, n, endpoint=False) + 5e-5,
            "lifts/duration": np.full(n, 1e-4),
            "lifts/shift": np.tile((0, 0, 0.2 / n, 0, 0, 0), (n, 1)),
        }
    )
    assert nd.check(run)["motion"].worst == pytest.approx(0.2, rel=1e-6)


def test_a_thin_coin_that_wobbles_passes():
    """Its contact goes around the rim so far in a step that it has another key."""
    run = nd.simulate(thin_coin(9.46), 0.06, 4e-3)
    assert np.unique(run.columns["contacts/key"]).size > 1
    assert nd.check(run)["velocities"].passed


def test_a_coin_that_strikes_and_rolls_with_theta_1_passes():
    """Its contact is new there, and goes around the rim from the impact and the move, which are of one time."""
    scene, tilt, r, h = nd.Scene(), np.radians(5.0), 0.1, 0.03
    scene.add_halfspace("ground")
    how = {"position": (0, 0, r * np.sin(tilt) + 0.5 * h * np.cos(tilt) + 2e-3), "angular_velocity": (0, 3, 0)}
    scene.add_cylinder("coin", r, h, 1.0, quaternion=Rotation.from_euler("x", tilt).as_quat(), **how)
    found = nd.check(nd.simulate(scene, 0.2, 2e-3, theta=1.0))["partings"]
    assert found.passed, found


def test_works_in_a_move_that_catches_impacts_of_what_rebounds_and_what_does_not():
    """A can falls on its rim where an egg bounces: both strike, and gravity moves both on, in one move."""
    scene = nd.Scene()
    scene.add_halfspace("ground")
    how = {"position": (0.21, -0.16, 0.06), "linear_velocity": (0.1, -1.0, -0.5), "angular_velocity": (9.9, 0.7, 10.9)}
    turn = Rotation.from_quat((-0.1, 0.1, -0.8, 0.6)).as_quat()
    scene.add_ellipsoid("egg", (0.1, 0.08, 0.05), 0.17, quaternion=turn, **how)
    how = {"position": (0.06, -0.22, 0.13), "linear_velocity": (0.2, -0.2, -4.6), "angular_velocity": (0.4, -1.0, 7.3)}
    turn = Rotation.from_quat((-0.6, 0.8, -0.1, 0.0)).as_quat()
    scene.add_cylinder("can", 0.06, 0.16, 0.9, quaternion=turn, **how)
    scene.set_pair("ground", "egg", restitution=0.2)
    scene.set_pair("can", "egg", restitution=0.4)
    run = nd.simulate(scene, 0.04, 5e-3)
    c = run.columns
    caught = (c["contacts/impulse"][:, 0] > 0.0) & (c["contacts/duration"] > 0.0)
    assert caught[c["contacts/restitution"] > 0.0].any()
    assert nd.check(run)["contact_works"].passed, nd.check(run)


def test_works_of_what_rebounds_in_a_move_on_a_floor_that_rises():
    """A can rocks on its rims, whose impacts are caught: the rest of each move is booked as numerics."""
    scene, smooth = nd.Scene(), nd.Material(mu=0.0, restitution=0.3)
    scene.add_box("floor", (4, 4, 0.2), position=(0, 0, -0.1), fixed=True)
    scene.set_motion("floor", velocity=(0, 0, 0.05))
    how = {"quaternion": Rotation.from_euler("x", np.radians(10.0)).as_quat(), "angular_velocity": (0, 1, 0)}
    scene.add_cylinder("can", 0.06, 0.16, 1.0, position=(0, 0, 0.13), material=smooth, **how)
    run = nd.simulate(scene, 0.3, 2e-2, theta=0.7)
    assert nd.check(run)["works"].passed, nd.check(run)


def test_works_of_impacts_in_a_row_by_fremonds_law():
    """A box that slides is hit by another; what parts may come back and strike once more, without restitution."""
    scene = nd.Scene()
    scene.add_halfspace("ground", material=nd.Material(mu=0.2))
    scene.add_box("one", (0.2, 0.2, 0.1), 1.0, position=(0, 0, 0.05), linear_velocity=(0.5, 0, 0))
    how = {"linear_velocity": (0, 0.4, -0.6), "angular_velocity": (-1, 2, 0)}
    scene.add_box("two", (0.2, 0.15, 0.1), 1.0, position=(0.03, 0.02, 0.17), **how)
    run = nd.simulate(scene, 0.2, 1e-2, impact="fremond")
    assert nd.check(run)["contact_works"].passed, nd.check(run)


@pytest.mark.parametrize(("theta", "e"), [(0.5, 0.2), (0.5, 0.7), pytest.param(0.7, 0.4, marks=pytest.mark.slow)])
@pytest.mark.parametrize("kind", SETTLING)
def test_what_bounces_rolls_and_settles_passes(kind, theta, e):
    """Steps are cut at bounces and where slip ends: what acts in pieces of them is told from impacts."""
    scene, material = nd.Scene(), nd.Material(mu=0.5, restitution=e)
    scene.add_halfspace("ground", material=material)
    how = {"linear_velocity": (0.5, 0.2, 0), "angular_velocity": (1, -2, 3), "quaternion": (0.5, 0.1, 0.7, 0.5)}
    SETTLING[kind](scene, position=(0, 0, 0.3), material=material, **how)
    run = nd.simulate(scene, 0.8, 5e-3, theta=theta)
    assert (run.columns["contacts/duration"] == 0.0).any()
    assert nd.check(run).passed, nd.check(run)


def test_a_body_that_slides_and_spins_to_rest_passes_with_restitution():
    scene, material = nd.Scene(), nd.Material(mu=0.5, restitution=0.3)
    scene.add_halfspace("ground", material=material)
    motion = {"linear_velocity": (1.0, 0.3, 0), "angular_velocity": (0, 0, 3.0)}
    scene.add_box("box", (0.2, 0.2, 0.2), 1.0, position=(0, 0, 0.1), material=material, **motion)
    run = nd.simulate(scene, 0.3, 1e-2)
    assert (run.columns["contacts/duration"] < 1e-2).any() and nd.check(run).passed, nd.check(run)


def test_works_of_contacts_follow_from_the_momenta():
    """r · ½ (u⁻ + u⁺), the velocities from the impulses alone: a box slides, balls strike within steps."""
    scene = nd.Scene(gravity=(0, 0, 0))
    material = nd.Material(mu=0.3, restitution=0.5)
    for k, x in enumerate((0.0, 0.25, 0.31)):
        scene.add_sphere(
            f"ball{k}",
            0.1,
            1.0,
            position=(x, 0.1 * x, 0.25 * k),
            linear_velocity=(0, 0, -5.0 * k),
            angular_velocity=(9, 0, 7 * k),
            material=material,
        )
    for trajectory in (nd.simulate(nd.scenes.load("slide")(), 0.1, dt=0.01), nd.simulate(scene, 0.1, dt=0.01)):
        c, u = trajectory.columns, Flight.of(Poses(trajectory), "not followed").met.mean
        for name, some in (("normal", slice(0, 1)), ("friction", slice(1, 3))):
            work, found = c[f"contacts/work_{name}"], (c["contacts/impulse"][:, some] * u[:, some]).sum(axis=1)
            np.testing.assert_allclose(found, work, rtol=0, atol=1e-12)
        assert c["contacts/work_friction"].min() < -1e-3


@pytest.mark.slow
def test_dominoes_that_lie_on_each_other_pass():
    """Sides that are almost parallel cross where a turn of 1e-7 takes them 2e-4 m away."""
    run = nd.simulate(nd.scenes.load("domino")(count=8), 0.5, dt=5e-3)
    assert nd.check(run).passed


@pytest.mark.slow
def test_a_heap_whose_lifts_pass_through_bodies_passes():
    """In step 83 the lift of the boxes above moves one by 5e-8 m across normals that are parallel to 1e-8."""
    rng, heap = np.random.default_rng(1), nd.Scene()
    heap.add_halfspace("ground", material=nd.Material(mu=0.5))
    for k in range(100):
        turn = rng.normal(size=4)
        pose = {"position": (0.22 * (k % 5), 0.22 * (k // 5 % 5), 0.2 + 0.25 * (k // 25))}
        pose |= {"quaternion": turn / np.linalg.norm(turn)}
        heap.add_box(f"b{k}", (0.1, 0.12, 0.15), 1.0, **pose, material=nd.Material(mu=0.5))
    assert nd.check(nd.simulate(heap, 0.42, dt=5e-3, on_fail="ignore")).passed


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 2])
def test_a_pile_passes(seed):
    """More impacts fall into a step than it is cut at: bodies are lifted, slip turns round, edges meet beside faces."""
    audit = nd.check(nd.simulate(nd.scenes.load("pile")(seed=seed), 1.0, dt=5e-3))
    assert audit.passed, audit


def test_couples_of_bodies_that_spin_together():
    """One ball turns the other by ±1e-3 N·m·s, which is nothing where it is recorded, and found where it is not."""
    scene = nd.Scene(gravity=(0, 0, 0), name="balls")
    for k, spin in enumerate((50.0, 51.0)):
        move = {"linear_velocity": (0, 0, -1.0 * k), "angular_velocity": (spin, 0, 0)}
        scene.add_sphere(f"ball{k}", 0.1, 1.0, position=(0, 0, 0.201 * k), material=nd.Material(mu=0.0), **move)
    trajectory, couple = nd.simulate(scene, 0.002, dt=1e-3), 1e-3
    acting, took = rows(trajectory, "ball0", "ball1", step=2)[-1:], 0.0
    assert nd.check(trajectory).passed
    q, v = trajectory.q[-1].reshape(2, 7), trajectory.v[-1].reshape(2, 6)
    for k, sign in enumerate((-1, 1)):
        before = v[k, 3:].copy()
        v[k, 3:] += Rotation.from_quat(q[k, 3:]).inv().apply((sign * couple / 0.004, 0, 0))  # 2/5 m r²
        took += 0.5 * 0.004 * (v[k, 3:] @ v[k, 3:] - before @ before)
    trajectory.energy.kinetic[-1] += took
    trajectory.energy.integration[-1] += took
    trajectory.columns["contacts/work_normal"][acting] += took
    audit = nd.check(trajectory)
    assert not audit["spin"].passed and all(audit[name].passed for name in ("energy", "works", "balance"))
    trajectory.columns["contacts/couple"][acting] += (couple, 0, 0)
    assert nd.check(trajectory)["spin"].passed
    trajectory.columns["contacts/couple"][:] = np.nan
    assert not nd.check(trajectory)["numbers"].passed


def test_tops_turn_as_poinsot_found():
    """Symmetric ones: about L at ‖L‖ / J₁, and about their own axis at L₃ (1/J₃ - 1/J₁)."""
    rng = np.random.default_rng(3)
    turn, L, J = Rotation.random(20, rng=rng), rng.normal(size=(20, 3)), rng.uniform(0.5, 1.0, (20, 2))
    time = 2.0 * np.pi * J.min(axis=1) / np.linalg.norm(L, axis=1)
    inertia = np.array([np.diag([a, a, c]) for a, c in J])
    own = turn.inv().apply(L)[:, 2] * (1.0 / J[:, 1] - 1.0 / J[:, 0]) * time
    space = Rotation.from_rotvec(L * (time / J[:, 0])[:, None])
    exact = space * turn * Rotation.from_rotvec(own[:, None] * [0.0, 0.0, 1.0])
    spin = turn.inv().apply(L) / np.diagonal(inertia, axis1=1, axis2=2)
    found = Rotation.from_quat(tumbled(turn.as_quat(), spin, inertia, time)[0])
    assert (exact.inv() * found).magnitude().max() < 1e-10


def test_motion_of_a_needle():
    """A thousand times as long as wide, with 0.1 rad a step about itself: its tilt leaves that alone."""
    scene = nd.Scene(gravity=(0, 0, 0))
    scene.add_capsule("needle", 1e-4, 0.1, 1.0, angular_velocity=(60.0, 90.0, 100.0))
    assert nd.check(nd.simulate(scene, 0.02, dt=1e-3))["motion"].amount < 1e-8


@pytest.mark.parametrize("bounces", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_motion_of_what_turns_round_in_a_step(bounces):
    """A box that turns by 5 rad a step, in flight and where it strikes; a turn of 0.2 rad more is found."""
    scene = nd.Scene(gravity=(0, 0, 0))
    spin = (300.0, 300.0, 250.0)
    scene.add_box("box", (0.1, 0.2, 0.3), 1.0, position=(0, 0, 0.3), linear_velocity=(0, 0, -5), angular_velocity=spin)
    if bounces:
        scene.add_halfspace("ground", material=nd.Material(mu=0.3, restitution=0.8))
    trajectory = nd.simulate(scene, 0.1, dt=0.01)
    assert trajectory.has_contacts and (trajectory.columns["contacts/impulse"].size > 0) == bounces
    assert nd.check(trajectory)["motion"].worst < 1e-3
    q = trajectory.q[-1, 3:7]
    q[:] = (Rotation.from_quat(q) * Rotation.from_rotvec([0.2, 0.0, 0.0])).as_quat()
    failed(trajectory, "motion", 10, "box")
