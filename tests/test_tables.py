"""Tables of recordings against sums over `trajectory.contacts` and against the motion."""

import csv
import sys
from types import SimpleNamespace

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


def test_contact_table_holds_all_contacts(trajectory, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)  # not to be imported
    table = trajectory.contact_table()
    tables = [trajectory.contacts(k) for k in range(1, 41)]
    assert {len(column) for column in table.values()} == {sum(map(len, tables))}
    for k in (1, 17, 40):
        rows, one = table["step"] == k, tables[k - 1]
        assert rows.sum() == len(one) and set(table["t"][rows]) == {trajectory.t[k]}
        assert tuple(table["body1"][rows]) == one.body1 and tuple(table["body2"][rows]) == one.body2
        assert list(table["state"][rows]) == one.status_names
        impulse = np.column_stack([table[f"impulse_{axis}"][rows] for axis in "xyz"])
        np.testing.assert_allclose(impulse, one.impulse_world, rtol=0, atol=1e-15)
        np.testing.assert_array_equal(table["impulse_N"][rows], one.impulse[:, 0])
        np.testing.assert_array_equal(table["gap"][rows], one.gap)


def test_contact_table_is_a_frame_of_pandas_where_it_is(trajectory, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", SimpleNamespace(DataFrame=lambda columns: ("frame", *columns)))
    assert trajectory.contact_table()[:3] == ("frame", "step", "t")


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


def test_contacts_on_the_command_line(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["run", "slide", "--time", "0.02", "--dt", "1e-3", "-o", "run.h5"]) == 0
    capsys.readouterr()
    trajectory = nd.Trajectory.load("run.h5")
    assert cli.main(["contacts", "run.h5", "--step", "3", "--csv", "c.csv"]) == 0
    assert capsys.readouterr().out == f"{trajectory.contacts(3)}\n"
    head, *rows = csv.reader((tmp_path / "c.csv").read_text().splitlines())
    table = trajectory.contact_table()
    assert head == list(table) and len(rows) == len(table["t"])
    np.testing.assert_array_equal([float(row[head.index("impulse_z")]) for row in rows], table["impulse_z"])
    assert cli.main(["contacts", "run.h5", "--step", "99"]) == 2
    assert "--step must be one of 1 to 20, or -1 back, got 99" in capsys.readouterr().err


def test_joints_on_the_command_line(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["run", "four_bar", "--time", "0.02", "--dt", "2e-3", "-o", "run.h5"]) == 0
    capsys.readouterr()
    trajectory = nd.Trajectory.load("run.h5")
    assert cli.main(["joints", "run.h5", "--step", "3", "--joint", "*/*1", "--csv", "j.csv"]) == 0
    table = trajectory.joint_table("*/*1")
    head, *rows = csv.reader((tmp_path / "j.csv").read_text().splitlines())
    assert [name.partition(" ")[0] for name in head] == list(table) and len(rows) == len(table["t"])
    units = dict(name.partition(" ")[::2] for name in head)
    assert units["position"] == "[rad or m]" and units["reaction_force_x"] == "[N]" and units["step"] == ""
    assert units["reaction_torque_z"] == "[N m about its origin]"
    for k, name in enumerate(table):
        if name != "joint":
            np.testing.assert_array_equal([float(row[k]) for row in rows], table[name])
    assert {row[2] for row in rows} == set(table["joint"]) and np.isnan(table["position"]).any()
    # The printed step, a loop without a position.
    shown = [line.split() for line in capsys.readouterr().out.splitlines()]
    at = {line[0]: dict(zip(shown[0], line, strict=False)) for line in shown[1:]}
    (loop,) = [name for name in at if name in table["joint"].tolist() and at[name]["position"] == "-"]
    force = trajectory.loop(loop).reaction_force[2]
    np.testing.assert_allclose([float(at[loop][f"f_{axis}"]) for axis in "xyz"], force, rtol=1e-5, atol=1e-300)
    assert cli.main(["joints", "run.h5", "--joint", "four_bar/none"]) == 2
    assert "joints must match one of" in capsys.readouterr().err


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


def test_joints_of_an_old_recording():
    scene = nd.Scene()
    add(scene, "a", slider())
    t = nd.simulate(scene, 0.02, 1e-2)
    trees = [
        {key: value for key, value in a.items() if key not in ("sizes", "model")} for a in t.scene["articulations"]
    ]
    old = nd.Trajectory(t.meta, t.scene | {"articulations": trees}, t.columns)
    with pytest.raises(ValueError, match="before format 4"):
        old.joint("a/rail")
    with pytest.raises(ValueError, match="before format 4"):
        old.joint_table()
    assert np.isnan(old.reactions["a/rail"]).all()
