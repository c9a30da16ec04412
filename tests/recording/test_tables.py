"""Tables of recordings against sums over `trajectory.contacts` and against the motion."""

import copy
import csv
import re
import sys
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from mechanisms import add, slider
from test_articulations import HAND

import nsdyn as nd
from nsdyn import cli

MU = 0.3  # the geometric mean of the ground's and the default, 0.5


@pytest.fixture(scope="module")
def trajectory():
    """A box that slides, and one on it."""
    scene = nd.Scene()
    scene.add_halfspace("ground", material=nd.Material(MU**2 / 0.5))
    scene.add_box("below", (0.4, 0.4, 0.2), 2.0, position=(0, 0, 0.1), linear_velocity=(1, 0, 0))
    scene.add_box("above", (0.2, 0.2, 0.2), 1.0, position=(0.05, 0, 0.3), linear_velocity=(1, 0, 0))
    scene.add_sphere("far", 0.1, 1.0, position=(0, 5, 0.3))
    return nd.simulate(scene, 0.4, dt=0.01)


def vectors(table, name):
    return np.column_stack([table[f"{name}_{axis}"] for axis in "xyz"])


def test_table_of_contacts_holds_all(trajectory):
    table = trajectory.table("contacts")
    tables = [trajectory.contacts(k) for k in range(1, 41)]
    assert len(table) == sum(map(len, tables))
    for k in (1, 17, 40):
        rows, one = table[table["step"] == k], tables[k - 1]
        assert len(rows) == len(one) and set(rows["t"]) == {trajectory.t[k]}
        assert tuple(rows["body1"]) == one.body1 and tuple(rows["body2"]) == one.body2
        assert list(rows["state"]) == one.status_names
        np.testing.assert_allclose(vectors(rows, "impulse"), one.impulse_world, rtol=0, atol=1e-15)
        np.testing.assert_array_equal(rows["impulse_N"], one.impulse[:, 0])
        np.testing.assert_array_equal(rows["gap"], one.gap)
    assert set(trajectory.table("contacts", "above")["body1"]) == {"below"}


def test_table_of_bodies_is_their_motion(trajectory):
    table = trajectory.table("bodies")
    assert len(table) == 41 * 3
    for name in ("below", "above", "far"):
        rows, body = table[table["body"] == name], trajectory.body(name)
        np.testing.assert_array_equal(rows["t"], trajectory.t)
        np.testing.assert_array_equal(np.column_stack([rows[axis] for axis in "xyz"]), body.position)
        np.testing.assert_array_equal(vectors(rows, "v"), body.linear_velocity)
        np.testing.assert_array_equal(vectors(rows, "omega"), body.angular_velocity)
        np.testing.assert_allclose(rows["speed"], np.linalg.norm(body.linear_velocity, axis=1), rtol=1e-15)
        force = vectors(rows, "force")
        assert np.isnan(force[0]).all()  # no step ends there
        np.testing.assert_allclose(force[1:], trajectory.force(name), rtol=0, atol=1e-12)
    with pytest.raises(ValueError, match=r"did you mean 'below'\? bodies must be one of below, .*; got 'belo'"):
        trajectory.table("bodies", "belo")
    with pytest.raises(ValueError, match="the recording has no joints"):
        trajectory.table("joints")
    with pytest.raises(ValueError, match=r"kind of table must be one of bodies, joints, .*; got 'body'"):
        trajectory.table("body")


def test_table_of_pairs(trajectory):
    """The box below slides on the ground under both weights, then rests: slip, friction and normal force in newtons."""
    table = trajectory.table("pairs", "ground")
    assert set(zip(table["body1"], table["body2"], strict=True)) == {("ground", "below"), ("ground", "far")}
    rows, pair = table[table["body2"] == "below"], trajectory.pair("ground", "below")
    np.testing.assert_allclose(rows["normal_force"], 3 * 9.81, rtol=0, atol=1e-5)  # 1e-8 m/s of 3 kg over dt
    slides = trajectory.t[1:] < 0.33
    np.testing.assert_allclose(rows["friction_force"][slides], MU * 3 * 9.81, rtol=0, atol=1e-5)
    np.testing.assert_allclose(rows["slip"][slides], 1.0 - MU * 9.81 * trajectory.t[1:][slides], rtol=0, atol=1e-6)
    np.testing.assert_allclose(rows["friction_force"][-3:], 0.0, rtol=0, atol=1e-5)
    np.testing.assert_allclose(vectors(rows, "force"), pair.force, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(rows["gap"], pair.gap)
    np.testing.assert_allclose(rows["work"], pair.work, rtol=0, atol=1e-15)
    assert tuple(rows["state"]) == pair.state
    falls = table[table["body2"] == "far"]  # 0.2 m, in 0.2 s
    assert set(falls["state"][:15]) == {"apart"} and np.isnan(falls["gap"][:15]).all()
    assert len(trajectory.table("pairs", "ground | below")) == 40
    with pytest.raises(
        ValueError, match=r"pairs that touch, or bodies, must be one of .*ground \| below.*; got 'above | far'"
    ):
        trajectory.table("pairs", "above | far")


def test_names_stand_for_themselves():
    """A name that would mean something else as a pattern is found all the same, with what it means as one."""
    scene = nd.Scene()
    scene.add_halfspace("ground")
    for k, name in enumerate(("box[0]", "box[1]", "box0")):
        scene.add_box(name, (0.1, 0.1, 0.1), 1.0, position=(k, 0, 0.05))
    run = nd.simulate(scene, 0.02, dt=0.01)
    assert set(run.table("bodies", "box[1]")["body"]) == {"box[1]"}
    assert set(run.table("pairs", "ground | box[1]")["body2"]) == {"box[1]"}
    assert set(run.table("contacts", "box[0]")["body2"]) == {"box[0]", "box0"}


def test_misuse(trajectory):
    for pattern in (5, ["above"], None):
        for kind in ("bodies", "pairs", "contacts", "energy"):
            with pytest.raises(ValueError, match=r"a pattern of names must be a text, as .*, got"):
                trajectory.table(kind, pattern)
    for rows in (0, -1, 2.5, True, "all"):
        with pytest.raises(ValueError, match=f"rows must be a whole number, at least 1, got {rows!r}"):
            trajectory.energy_table(rows)


def test_table_of_energies(trajectory):
    table = trajectory.table("energy", "*ti*")
    assert list(table) == ["step", "t", "kinetic", "potential", "friction", "integration", "projection"]
    np.testing.assert_array_equal(table["kinetic"], trajectory.energy.kinetic)
    np.testing.assert_array_equal(table["friction"][1:], trajectory.energy.friction)
    assert table["friction"][0] == 0.0 and "normal" not in list(table)


def test_tables_are_written_and_read(trajectory, tmp_path):
    pandas = pytest.importorskip("pandas")
    pytest.importorskip("pyarrow")
    table = trajectory.table("bodies", "a*")
    frame = table.to_pandas()
    assert list(frame.columns) == list(table.headers) and len(frame) == len(table)
    assert {"t [s]", "x [m]", "speed [m/s]", "omega_z [rad/s]", "force_x [N]", "body"} < set(frame.columns)
    table.to_csv(tmp_path / "t.csv")
    table.to_parquet(tmp_path / "t.parquet")
    text = (tmp_path / "t.csv").read_text().splitlines()
    assert text[0] == ",".join(table.headers) and text[1].endswith(",,,")  # no force at the beginning
    for read in (pandas.read_csv(tmp_path / "t.csv"), pandas.read_parquet(tmp_path / "t.parquet")):
        assert list(read["body"]) == ["above"] * 41
        np.testing.assert_array_equal(read["speed [m/s]"], table["speed"])
        np.testing.assert_array_equal(read["force_z [N]"], table["force_z"])


def test_tables_without_their_extra(trajectory, tmp_path, monkeypatch):
    """The type stays, and what is missing is told."""
    table = trajectory.table("energy")
    for name in ("pandas", "pyarrow"):
        monkeypatch.setitem(sys.modules, name, None)  # not to be imported
    assert type(trajectory.table("energy")) is type(table) is nd.Table
    with pytest.raises(ValueError, match=r"pandas is needed: pip install 'nsdyn\[tables\]'"):
        table.to_pandas()
    with pytest.raises(ValueError, match=r"pyarrow is needed: pip install 'nsdyn\[tables\]'"):
        table.to_parquet(tmp_path / "t.parquet")
    assert not list(tmp_path.iterdir())


def test_tables_fit_into_lines(trajectory):
    """From both ends as many columns as there is room for, which is used; what is left out is told."""
    for kind in ("bodies", "pairs", "contacts", "energy"):
        table = trajectory.table(kind)
        lines = repr(table).splitlines()
        *shown, last = lines
        names = re.split(r" {2,}", shown[0].strip())
        left, right = names.index("..."), len(names) - 1 - names.index("...")
        assert names[:left] == list(table.headers[:left]) and names[left + 1 :] == list(table.headers[-right:])
        assert 0 <= left - right <= 1 and len(set(map(len, shown))) == 1 and len(shown[0]) <= 100
        assert f"{len(table.headers) - left - right} more columns" in last and len(last) <= 100
        whole = table.text().splitlines()
        assert re.split(r" {2,}", whole[0].strip()) == list(table.headers) and len(whole[0]) > 100
        widest = max(len(whole[0]), 101)
        assert table.text(len(whole[0])).splitlines()[0] == whole[0] and "..." in table.text(widest - 1)
    for width in (None, np.nan, "wide"):
        with pytest.raises(ValueError, match=f"width must be a number of characters, got {width!r}"):
            table.text(width)


def test_tables_show_themselves(trajectory):
    table = trajectory.table("bodies")
    lines = repr(table.select("t", "body", "speed")).splitlines()
    assert lines[0].split() == ["t", "[s]", "body", "speed", "[m/s]"] and lines[-1] == "... 83 more rows"
    rest = table[(table["step"] == 40) & (table["body"] == "below")].select("speed", "force_x", "force_z")
    assert repr(rest).splitlines()[1].split()[0] == "0" and rest["speed"] != 0.0  # round-off
    html = table._repr_html_()
    assert "force_z [N]" in html and "bodies, 20 rows: 103 more rows, " in html and html.count("<tr>") == 21
    with pytest.raises(ValueError, match=r"did you mean 'speed'\? column must be one of speed, .* others; got 'sped'"):
        table["sped"]
    for wrong in (["speed"], 1.5):
        with pytest.raises(ValueError, match="column must be one of"):
            table.select(wrong)
    with pytest.raises(ValueError, match=r"name must be that of a moving body, got \['below'\]"):
        trajectory.body(["below"])


@pytest.mark.parametrize("name", ["arm_pushes_box", "cart_pole", "heavy_on_light"])
def test_kinetic_energies_add_up_to_those_of_the_ledger(name):
    """Each mass once, those of links too."""
    run = nd.simulate(nd.scenes.load(name)(), 0.02, dt=2e-3)
    table = run.table("bodies")
    kinetic = np.nan_to_num(table["kinetic"]).reshape(run.t.size, -1).sum(axis=1)
    np.testing.assert_allclose(kinetic, run.energy.kinetic, rtol=1e-12, atol=1e-25)
    first = table[table["step"] == 0]
    known = np.isfinite(first["mass"])
    np.testing.assert_array_equal(known, np.isfinite(first["kinetic"]))
    assert known.any() and (first["mass"][known] > 0.0).all()


def test_velocities_of_driven_bodies():
    """As they were prescribed, to second order in dt: the error falls to a quarter."""

    def spin(t):
        return (0.3, 0.0, 0.1 * np.sin(3 * t)), (0.0, 0.0, np.cos(2 * t))

    worst = []
    for dt in (0.02, 0.01):
        scene = nd.Scene()
        scene.add_box("table", (0.4, 0.4, 0.1), fixed=True)
        scene.add_box("belt", (0.4, 0.4, 0.1), fixed=True, position=(0, 3, 0))
        scene.set_motion("table", spin)
        scene.set_motion("belt", (0.5, 0.0, 0.0))
        run = nd.simulate(scene, 0.4, dt=dt)
        table = run.table("bodies")
        belt, turns = (table[table["body"] == name] for name in ("belt", "table"))
        np.testing.assert_allclose(vectors(belt, "v"), np.tile((0.5, 0, 0), (len(belt), 1)), rtol=0, atol=1e-12)
        exact = np.array([np.concatenate(spin(t)) for t in run.t])
        found = np.hstack([vectors(turns, "v"), vectors(turns, "omega")])
        worst.append(np.abs(found - exact).max())
    assert worst[1] < 2e-4 and worst[0] / worst[1] == pytest.approx(4.0, rel=0.2)


def test_velocities_of_links(tmp_path):
    """By the joints, v and omega of a frame on a turning link; by the poses where these are of an unknown kind."""
    (tmp_path / "r.urdf").write_text(HAND)
    scene = nd.Scene()
    scene.add_urdf("r", tmp_path / "r.urdf", q=(1.0, 0.0), v=(2.0,), position=(0, 0, 1.0))
    run = nd.simulate(scene, 0.2, dt=1e-3)
    foot, rate = run.body("r/foot"), run.joint("r/shoulder").velocity
    slope = np.gradient(foot.position, run.t, axis=0)
    np.testing.assert_allclose(foot.linear_velocity[1:-1], slope[1:-1], rtol=0, atol=1e-4)  # second order in dt
    np.testing.assert_allclose(np.linalg.norm(foot.angular_velocity, axis=1), np.abs(rate), rtol=1e-12)
    trees = copy.deepcopy(run.scene["articulations"])
    trees[0]["model"]["joints"][0]["kind"] = "JointModelScrew"
    old = nd.Trajectory(run.meta, run.scene | {"articulations": trees}, run.columns).body("r/foot")
    np.testing.assert_allclose(old.linear_velocity, foot.linear_velocity, rtol=0, atol=1e-4)
    np.testing.assert_allclose(old.angular_velocity, foot.angular_velocity, rtol=0, atol=1e-4)


def test_pair_is_the_sum_of_its_contacts(trajectory):
    pair = trajectory.pair("below", "above")
    # The upper box is carried: 9.81 N up and, while both brake at mu g, mu of it backwards; 1e-8 m/s of 1 kg over dt.
    np.testing.assert_allclose(pair.force[:20], np.tile((-MU * 9.81, 0, 9.81), (20, 1)), rtol=0, atol=1e-6)
    other = trajectory.pair("above", "below")
    np.testing.assert_array_equal(other.force, -pair.force)
    np.testing.assert_array_equal(other.gap, pair.gap)
    k = 7
    table = trajectory.contacts(k + 1)
    mine = [i for i in range(len(table)) if {table.body1[i], table.body2[i]} == {"below", "above"}]
    sign = np.array([1.0 if table.body2[i] == "above" else -1.0 for i in mine])
    torque = (sign[:, None] * np.cross(table.point[mine], table.impulse_world[mine])).sum(axis=0) / 0.01
    np.testing.assert_allclose(pair.torque[k], torque, rtol=0, atol=1e-12)  # a few sums of 10 N m
    assert pair.gap[k] == table.gap[mine].min() and pair.state[k] == "stick"
    assert pair.work[k] == pytest.approx((table.work_normal + table.work_friction)[mine].sum(), abs=1e-15)


def test_states_of_pairs(trajectory):
    slides = trajectory.pair("ground", "below")
    assert slides.state[0] == "slip" and slides.state[-1] == "stick"  # it stops after v/(mu g) = 0.34 s
    assert slides.work.sum() == pytest.approx(trajectory.energy.friction.sum(), rel=1e-6)
    apart = trajectory.pair("far", "below")
    assert set(apart.state) == {"apart"} and not apart.force.any() and np.isinf(apart.gap).all()
    assert "2 steps, 1 of them pushing" in repr(replace(apart, state=("open", "jam")))
    with pytest.raises(ValueError, match=r"did you mean 'below'\? body must be one of .*; got 'belo'"):
        trajectory.pair("belo", "ground")


def test_force_is_the_change_of_momentum(trajectory):
    for name, mass in (("below", 2.0), ("above", 1.0), ("far", 1.0)):
        change = mass * np.diff(trajectory.body(name).linear_velocity, axis=0) / 0.01
        # 30 N to the round-off of differences over dt.
        np.testing.assert_allclose(trajectory.force(name) - np.array((0, 0, 9.81 * mass)), change, rtol=0, atol=1e-10)


def test_joints_and_forces_of_links(tmp_path):
    (tmp_path / "r.urdf").write_text(HAND)
    scene = nd.Scene()
    scene.add_sphere("ball", 0.1, 1.0, position=(0, 5, 0))
    scene.add_urdf("r", tmp_path / "r.urdf", q=(np.cos(3.0), np.sin(3.0)), v=(2.0,), position=(0, 0, 1.0))
    scene.add_box("stop", (0.2, 0.2, 0.2), position=(-0.45, 0, 2.25), fixed=True)
    trajectory = nd.simulate(scene, 0.3, dt=1e-3)
    joint = trajectory.joint("r/shoulder")
    assert joint.position[0] == pytest.approx(3.0, abs=1e-12) and joint.velocity[0] == 2.0
    # The trapezoidal rule, second order in dt = 1e-3; the angle goes on beyond pi.
    moved = np.cumsum(0.5e-3 * (joint.velocity[1:] + joint.velocity[:-1]))
    np.testing.assert_allclose(joint.position[1:] - 3.0, moved, rtol=0, atol=1e-3)
    np.testing.assert_array_equal(trajectory.force("r/foot"), trajectory.force("r"))
    np.testing.assert_array_equal(trajectory.force("r/foot"), -trajectory.force("stop"))
    assert trajectory.force("r/foot").any()
    with pytest.raises(ValueError, match=r"joint must be one of r/shoulder; got 'r/sholder'"):
        trajectory.joint("r/sholder")


@pytest.mark.parametrize("kind", ["bodies", "pairs", "contacts"])
def test_tables_on_the_command_line(trajectory, kind, tmp_path, capsys, monkeypatch):
    pytest.importorskip("pyarrow")
    monkeypatch.chdir(tmp_path)
    trajectory.save("run.h5")
    given = "--name", "below", "--step", "3", "--csv", "t.csv", "--parquet", "t.parquet"
    assert cli.main([kind, "run.h5", *given]) == 0
    table = trajectory.table(kind, "below")
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 2 + (table["step"] == 3).sum() and "step 3, which ends at t = 0.03 s" in lines[-1]
    head, *rows = csv.reader((tmp_path / "t.csv").read_text().splitlines())
    assert head == list(table.headers) and len(rows) == len(table)
    assert (tmp_path / "t.parquet").read_bytes().startswith(b"PAR1")
    for step in ("0", "99"):
        assert cli.main([kind, "run.h5", "--step", step]) == 2
        assert f"--step must be one of 1 to 40, or -1 back, got {step}" in capsys.readouterr().err
    assert cli.main([kind, "run.h5", "--name", "belo", "--csv", "no.csv"]) == 2
    assert "did you mean 'below'" in capsys.readouterr().err and not (tmp_path / "no.csv").exists()


def test_joints_on_the_command_line(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["run", "four_bar", "--time", "0.02", "--dt", "2e-3", "-o", "run.h5"]) == 0
    capsys.readouterr()
    trajectory = nd.Trajectory.load("run.h5")
    assert cli.main(["joints", "run.h5", "--step", "3", "--name", "*/*1", "--csv", "j.csv"]) == 0
    table = trajectory.table("joints", "*/*1")
    # As plots call them: without their robot.
    assert set(trajectory.table("joints", "top1")["joint"]) == {"linkage/top1"}
    head, *rows = csv.reader((tmp_path / "j.csv").read_text().splitlines())
    assert head == list(table.headers) and len(rows) == len(table)
    assert {"position [rad or m]", "limit [N m or N]", "reaction_force_x [N]", "reaction_torque_z [N m]"} < set(head)
    for k, name in enumerate(table):
        if table[name].dtype.kind == "f":
            np.testing.assert_array_equal([float(row[k] or "nan") for row in rows], table[name])
    assert {row[2] for row in rows} == set(table["joint"]) and np.isnan(table["position"]).any()
    # The printed step, a loop without a position.
    shown = [line.split() for line in capsys.readouterr().out.splitlines()]
    (loop,) = [line for line in shown if line[0] in table["joint"] and line[3] == "-"]
    force = trajectory.loop(loop[0]).reaction_force[2]
    np.testing.assert_allclose([float(x) for x in loop[-3:]], force, rtol=1e-5, atol=1e-300)
    assert cli.main(["joints", "run.h5", "--name", "four_bar/none"]) == 2
    assert "joints must be one of" in capsys.readouterr().err


def test_what_acts_in_a_joint(tmp_path):
    """A slider of 2 kg that a force of 5 N pushes against 3 N of dry friction until its stop, and holds it there."""
    push = {"a": np.array([5.0])}

    def run(path=None, **options):
        scene = nd.Scene()
        scene.add_sphere("ball", 0.1, 1.0, position=(0, 5, 0))
        add(scene, "a", slider(2.0, upper=0.1), friction=3.0)
        return nd.simulate(scene, 0.6, dt=1e-2, controller=lambda t, q, v: push, record=path, **options)

    trajectory = run()
    joint = trajectory.joint("a/rail")
    assert joint.velocity.shape == (61,) and joint.torque.shape == trajectory.t_steps.shape == (60,)
    np.testing.assert_array_equal(joint.torque, np.full(60, 5.0))
    moving = joint.velocity[1:] > 1e-9
    np.testing.assert_allclose(joint.friction[moving][:-1], -3.0, rtol=0, atol=1e-12)
    # It arrives at √(2 a s) = √0.2 m/s, and the stop takes that momentum.
    assert joint.limit_impulse.min() == pytest.approx(-2.0 * np.sqrt(0.2), rel=1e-2)
    # At rest on the stop the forces on it vanish.
    total = joint.torque + joint.friction + joint.limit_impulse / 1e-2
    np.testing.assert_allclose(total[-5:], 0.0, rtol=0, atol=1e-9)
    # m Δv is the sum of the impulses in every step, also where several are recorded as one, in a file too.
    np.testing.assert_allclose(2.0 * np.diff(joint.velocity), 1e-2 * total, rtol=0, atol=1e-14)
    some = run(tmp_path / "some.h5", every=4).joint("a/rail")
    np.testing.assert_allclose(some.limit_impulse, joint.limit_impulse.reshape(-1, 4).sum(axis=1), rtol=0, atol=1e-15)
    np.testing.assert_allclose(some.friction, joint.friction.reshape(-1, 4).mean(axis=1), rtol=0, atol=1e-14)


def test_torque_of_a_control_is_what_moves_the_joint():
    """An implicit PD control on a slider, which a wrench pushes too: m Δv/h less the wrench."""
    scene = nd.Scene()
    model = slider(2.0)
    model.addBodyFrame("cart", 1, pin.SE3.Identity(), 0)
    add(scene, "a", model)
    control = {"a": nd.PD(kp=100.0, kd=3.0, target=0.1)}
    pushed = {"a/cart": (7.0, 0.0, 0.0)}
    trajectory = nd.simulate(
        scene, 0.3, dt=1e-2, controller=lambda t, q, v: control, external_force=lambda t, q, v: pushed
    )
    joint = trajectory.joint("a/rail")
    torque = 2.0 * np.diff(joint.velocity) / 1e-2 - 7.0
    np.testing.assert_allclose(joint.torque, torque, rtol=0, atol=1e-11)  # round-off of differences over dt
    np.testing.assert_allclose(joint.external, 7.0, rtol=1e-14)
    # It is not kp (target - q) of the beginning, 10 N, which explicit control would give.
    assert joint.torque[0] < 9.9
