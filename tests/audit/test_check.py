"""`nsdyn check` and `nd.check`: one way for motions, scenes and robot files, of which nothing is lost in silence."""

import re

import numpy as np
import pytest

import nsdyn as nd
from nsdyn import cli


@pytest.fixture
def run(capsys, tmp_path, monkeypatch):
    """Run `nsdyn check` in an empty folder; (exit code, stdout, stderr)."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments):
        try:
            code = cli.main(["check", *map(str, arguments)])
        except SystemExit as exit_:  # argparse's
            code = exit_.code
        return code, *capsys.readouterr()

    return run


BALL = '<body name="b" pos="0 0 0.5"><freejoint/><geom size="0.05" mass="1"/></body>'
HFIELD = f"""<mujoco><asset><hfield name="h" nrow="3" ncol="3" size="1 1 .2 .1" elevation="0 0 0 0 1 0 0 0 0"/></asset>
<worldbody><geom name="t" type="hfield" hfield="h"/>{BALL}</worldbody></mujoco>"""


def test_a_ground_that_is_not_read_fails_by_its_name(run, tmp_path):
    (tmp_path / "hf.xml").write_text(HFIELD)
    code, out, _ = run("hf.xml")
    assert code == 1 and out.splitlines()[-1] == "hf.xml: FAILED"
    assert "missing, not read: robot: geom 't' of type 'hfield' on body 'world'" in out.splitlines()
    with pytest.warns(UserWarning, match="^'m' leaves out: geom 't' of type 'hfield' on body 'world'$"):
        nd.Scene().add_mjcf("m", tmp_path / "hf.xml")
    (tmp_path / "seen.xml").write_text(HFIELD.replace('name="t"', 'name="t" contype="0" conaffinity="0"'))
    assert run("seen.xml")[0] == 0, "a picture of a ground"


TWO = """<mujoco><default><tendon {default}/></default><worldbody>
<body name="a"><joint name="ja" axis="0 0 1"/><geom name="ga" size="0.1"/></body>
<body name="b" pos="1 0 0"><joint name="jb" axis="0 0 1"/><geom name="gb" size="0.1" {geom}/></body>
</worldbody>{more}</mujoco>"""
FIXED = '<tendon><fixed name="t" {}><joint joint="ja" coef="1"/></fixed></tendon>'


def test_a_sheet_is_told_in_one_line(run, tmp_path):
    """A box thinner than its rounding, of which Qhull makes no hull."""
    (tmp_path / "r.xml").write_text(HFIELD.replace('type="hfield" hfield="h"', 'type="box" size="1e-30 .1 .1"'))
    code, out, err = run("r.xml")
    assert code == 2 and out == "" and err.count("\n") == 1 and "'robot/t' must be thicker than the rounding" in err


@pytest.mark.parametrize(
    ("given", "what", "note"),
    [
        ({"more": '<actuator><motor name="m1" joint="ja"/></actuator>'}, None, None),
        ({"more": '<actuator><cylinder joint="jb"/></actuator>'}, "dropped", "<actuator> 'jb': of kind 'cylinder'"),
        ({"more": FIXED.format("")}, "dropped", "<tendon> 't'"),
        ({"more": FIXED.format('stiffness="3"')}, "missing", "<tendon> 't'"),
        ({"more": FIXED.format(""), "default": 'range="0 1"'}, "missing", "<tendon> 't'"),
        (
            {"more": '<equality><joint name="e" joint1="ja" joint2="jb" polycoef="0 1 1 0 0"/></equality>'},
            "missing",
            "equality 'e': polycoef of degree 2, not linear",
        ),
        ({"more": '<equality><joint name="e" joint1="ja" joint2="jb"/></equality>'}, None, None),
        ({"more": '<equality><joint joint1="ja" active="false"/></equality>'}, None, None),
        ({"more": '<equality><connect body1="a" body2="b" anchor="0.5 0 0"/></equality>'}, None, None),
        ({"more": "<deformable><skin/></deformable>"}, None, None),
        ({"more": "<deformable><flex/></deformable>"}, "missing", "deformable: <flex>"),
        ({"more": '<contact><pair geom1="ga" geom2="gb"/></contact>'}, "dropped", "contact: <pair> of 'ga' and 'gb'"),
        (
            {"more": '<contact><pair geom1="ga" geom2="gb"/></contact>', "geom": 'contype="2" conaffinity="2"'},
            "missing",
            "contact: <pair> of 'ga' and 'gb'",
        ),
    ],
)
def test_what_carries_weight_fails_or_warns_by_its_name(run, tmp_path, given, what, note):
    (tmp_path / "two.xml").write_text(TWO.format(**{"default": "", "geom": ""} | given))
    found = nd.check(tmp_path / "two.xml")
    assert found.passed is (what != "missing")
    assert {"missing": found.missing, "dropped": found.dropped} == {
        "missing": (),
        "dropped": (),
    } | ({what: (f"robot: {note}",)} if what else {})
    code, out, _ = run("two.xml")
    assert out == f"{found}\n" and code == (0 if found.passed else 1)


def test_a_shape_of_sdf_that_is_not_read_fails(tmp_path):
    shape = "<collision name='c'><geometry><heightmap/></geometry></collision>"
    (tmp_path / "r.sdf").write_text(f"<sdf version='1.9'><model name='m'><link name='a'>{shape}</link></model></sdf>")
    found = nd.check(tmp_path / "r.sdf")
    assert not found.passed and found.missing == ("robot: collision 'c' of link 'a': its shape",)


def test_a_quadruped_of_example_robot_data(share, run):
    """Its knees start outside their limits at q = 0; what it weighs is all of it, standing free or held."""
    path = share / "example-robot-data/robots/a1_description/urdf/a1.urdf"
    # The sum of the 22 masses in the file.
    code, out, _ = run(path, "--base", "free", "--package-dir", share)
    assert code == 0 and ", 13.741 kg in all, moving from 0.226 to 6 kg" in out.splitlines()[0]
    assert out.count("note: starts outside its limits unless q is given: robot/F") == 2
    assert "[rad, m]" in out and "[N m, N]" in out and "[N m s, N s/m]" in out
    code, out, _ = run(path)
    assert code == 0 and ", 13.741 kg in all, 6.001 kg of it fixed, moving from 0.226 to" in out.splitlines()[0]
    assert out.splitlines()[2].split()[:3] == ["robot", "(fixed)", "6.001"]
    stance = ",".join(4 * ["0,0.8,-1.5"])
    code, out, _ = run(path, "--base", "free", "-q", stance)
    assert code == 0 and "note" not in out
    code, out, _ = run(path, "-q", stance.replace("-1.5", "-0.5", 1))
    assert code == 1 and "outside its limits: robot/FL_calf_joint at -0.5, from -2.69653 to -0.916298" in out


def test_the_start_of_a_robot_is_chosen(run, tmp_path):
    """Of a ball on a slide, by keyframe and q; what overlaps where it cannot start is a note."""
    (tmp_path / "r.xml").write_text(
        '<mujoco><worldbody><geom name="floor" type="plane" size="0 0 1"/><body name="b" pos="0 0 0">'
        '<joint name="j" type="slide" axis="0 0 1" range="0.1 1"/><geom name="ball" size="0.1"/></body></worldbody>'
        '<keyframe><key name="on" qpos="0.1"/><key name="in" qpos="0.05"/></keyframe></mujoco>'
    )
    code, out, _ = run("r.xml")
    assert code == 0 and "note: overlaps there: robot/floor and robot/ball by 0.1 m" in out
    assert run("r.xml", "--keyframe", "on")[0] == run("r.xml", "-q=0.2")[0] == 0
    code, out, _ = run("r.xml", "--keyframe", "in")
    assert code == 1 and "overlaps at the start: robot/floor and robot/ball by 0.05 m" in out
    assert "outside its limits: robot/j at 0.05, from 0.1 to 1" in out
    assert run("r.xml", "-q=-1")[0] == 1


def test_the_same_check_in_python(run, tmp_path, robot):
    scene = nd.scenes.load("stack")(height=2)
    assert isinstance(nd.check(scene), nd.Inspection) and nd.check(scene).passed
    trajectory = nd.simulate(scene, 0.05, dt=1e-2)
    trajectory.save(tmp_path / "run.h5")
    assert isinstance(nd.check(trajectory), nd.Audit)
    for path in (tmp_path / "run.h5", str(tmp_path / "run.h5")):
        assert repr(nd.check(path)) == repr(nd.check(trajectory)) == run(path)[1].removesuffix("\n")
    assert not nd.check(tmp_path / "run.h5", overlap=-1.0).passed
    assert repr(nd.check("stack", height=2)) == run("stack", "--set", "height=2")[1].removesuffix("\n")
    (tmp_path / "r.xml").write_text(HFIELD)
    assert repr(nd.check(tmp_path / "r.xml")) == run("r.xml")[1].removesuffix("\n")
    path, package_dirs = robot
    free = nd.check(path, base="free", package_dirs=package_dirs, collisions=False, q=np.r_[0.5, 1, 0, 0])
    assert free.joints[0].at == 0.5 and not any(body.fixed for body in free.masses)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["README.md"], r"README\.md is no robot file \(\.urdf, .*\), scene \(\.py\) or recording \(\.h5, \.hdf5\)"),
        (["gone.h5"], "no such recording: gone.h5"),
        (["gone.urdf"], "path of 'robot' must be a file in URDF, got 'gone.urdf'"),
        (["slide", "--base", "free"], "base is for robot files, which slide is not"),
        (["r.xml", "--set", "mu=1"], "--set is for scenes, which r.xml is not"),
        (["r.xml", "--base", "free"], "base is for .urdf files, which r.xml is not"),
        (["r.xml", "--package-dir", "."], "--package-dir is for .urdf and .sdf files, which r.xml is not"),
        (["r.xml", "--keyframe", "sit"], "keyframe must be one of none; got 'sit'"),
        (["r.xml", "-q", "1,2"], r"q of 'robot' must be 7 numbers, got shape \(2,\)"),
        (["r.xml", "-q", "1,x"], "-q must be a number, got 'x'"),
        (["r.urdf", "--keyframe", "a"], "keyframe is for .xml and .mjcf files, which r.urdf is not"),
    ],
)
def test_what_does_not_fit_is_told_in_one_line(run, tmp_path, arguments, words):
    (tmp_path / "r.xml").write_text(HFIELD)
    code, out, err = run(*arguments)
    assert code == 2 and out == "" and err.count("\n") == 1 and re.search(words, err)


def test_options_that_do_not_fit_are_refused(tmp_path):
    (tmp_path / "r.xml").write_text(HFIELD)
    with pytest.raises(
        ValueError, match=r"did you mean 'self_collisions'\? keyword must be one of .*; got 'self_colisions'"
    ):
        nd.check(tmp_path / "r.xml", self_colisions=False)
    with pytest.raises(ValueError, match="check of a scene takes no options, got overlap"):
        nd.check(nd.Scene(), overlap=1.0)
    with pytest.raises(ValueError, match="what to check, if it is no Trajectory and no Scene, must be a path, got 3"):
        nd.check(3)


def test_masses_have_the_names_of_bodies(tmp_path):
    """Not of what they hang on: two hinges of one body, a free joint, a weld, or a base that the file leaves fixed."""
    ball = '<geom size="0.05" mass="1"/>'
    (tmp_path / "r.xml").write_text(
        f'<mujoco><worldbody>{BALL}<body name="arm" pos="1 0 0"><joint name="j1" axis="1 0 0"/>'
        f'<joint name="j2" axis="0 1 0"/>{ball}<body name="welded" pos="0 0 1">{ball}</body>'
        f'<body name="hand" pos="0 0 2"><joint name="j3"/>{ball}</body></body></worldbody></mujoco>'
    )
    found = nd.check(tmp_path / "r.xml").masses
    assert [(body.name, body.mass) for body in found] == [("robot/b", 1.0), ("robot/arm", 2.0), ("robot/hand", 1.0)]


def test_joints_have_all_their_coordinates(tmp_path):
    """Two hinges and a slide of one body, each in its own range."""
    (tmp_path / "r.xml").write_text(
        '<mujoco><worldbody><body name="arm"><joint name="j1" axis="1 0 0" range="-30 60" limited="true"/>'
        '<joint name="j2" axis="0 1 0"/><joint name="j3" type="slide" range="-0.1 0.2" limited="true"/>'
        '<geom size="0.05" mass="1"/></body></worldbody></mujoco>'
    )
    joints = nd.check(tmp_path / "r.xml").joints
    assert [joint.name for joint in joints] == ["robot/j1", "robot/j2", "robot/j3"]
    ranges = [(joint.lower, joint.upper) for joint in joints]
    assert ranges == [pytest.approx((-np.pi / 6, np.pi / 3)), (-np.inf, np.inf), pytest.approx((-0.1, 0.2))]
