"""Energies by pair and body, pictures, scene files of one's own: against sums, what axes hold, by running."""

import csv
import json
import pydoc
import re
import time

import matplotlib
import numpy as np
import pytest

import nsdyn as nd
from nsdyn.study.refinement import order

matplotlib.use("Agg")


@pytest.fixture(scope="module")
def trajectory():
    """A box that slides with one on it, which slides too, and a ball that bounces."""
    scene = nd.Scene()
    scene.add_halfspace("ground", material=nd.Material(0.5, 0.5))
    scene.add_box("below", (0.6, 0.4, 0.2), 2.0, position=(0, 0, 0.1), linear_velocity=(1, 0, 0))
    scene.add_box("above", (0.2, 0.2, 0.2), 1.0, position=(0.05, 0, 0.3), linear_velocity=(1, 0, 0))
    scene.set_pair("below", "above", mu=0.1)
    scene.add_sphere("ball", 0.1, 1.0, position=(0, 5, 0.3))
    return nd.simulate(scene, 0.4, dt=0.01)


def test_works_of_pairs_sum_up_to_the_ledger(trajectory):
    works = trajectory.pair_works()
    assert set(works) == {("below", "ground"), ("above", "below"), ("ball", "ground")}
    sums = [abs(float(normal.sum() + friction.sum())) for normal, friction in works.values()]
    assert sums == sorted(sums, reverse=True)
    normal, friction = (sum(work[k] for work in works.values()) for k in range(2))
    e = trajectory.energy
    # What contacts do that stay closed and stick is booked as integration.
    np.testing.assert_allclose(normal + friction, e.normal + e.friction + e.integration, rtol=0, atol=1e-12)
    mine = trajectory.pair("below", "above").work
    np.testing.assert_allclose(sum(works["above", "below"]), mine, rtol=0, atol=1e-15)
    assert works["above", "below"][1].sum() < -1e-3 and works["ball", "ground"][0].sum() < -0.1
    sparse = nd.simulate(nd.scenes.load("slide")(), 0.02, every=2)
    with pytest.raises(ValueError, match="works of pairs need every step, the recording has one of every 2"):
        sparse.pair_works()
    with pytest.raises(ValueError, match="the recording has no contacts"):
        nd.simulate(nd.scenes.load("slide")(), 0.02, contacts=False).pair_works()


def test_energies_of_bodies_sum_up_to_the_ledger(trajectory):
    energies = trajectory.body_energies()
    assert list(energies) == ["below", "above", "ball"]
    kinetic, potential = (sum(energy[k] for energy in energies.values()) for k in range(2))
    np.testing.assert_allclose(kinetic, trajectory.energy.kinetic, rtol=0, atol=1e-14)
    np.testing.assert_allclose(potential, trajectory.energy.potential, rtol=0, atol=1e-13)
    assert energies["ball"][1][0] == pytest.approx(9.81 * 0.3)
    tumble = nd.simulate(nd.scenes.load("intermediate_axis")(), 0.1, dt=1e-2)
    (only,) = tumble.body_energies().values()
    np.testing.assert_allclose(only[0], tumble.energy.kinetic, rtol=1e-14)  # turning alone
    mixed = nd.simulate(nd.scenes.load("arm_pushes_box")(), 0.02, dt=1e-2)
    (*_, arm), (*_, name) = mixed.body_energies().values(), mixed.body_energies()
    assert name == mixed.scene["articulations"][0]["name"] and arm[0].shape == mixed.t.shape


def test_energy_by_on_the_command_line(trajectory, run, tmp_path):
    trajectory.save("run.h5")
    code, out, _ = run("energy", "run.h5", "--by", "pair", "--csv", "p.csv")
    lines = {line.rpartition("  ")[0].split("  ")[0]: line.split()[-1] for line in out.splitlines()}
    assert code == 0 and float(lines["ledger"]) == pytest.approx(
        float((trajectory.energy.normal + trajectory.energy.friction).sum()), rel=1e-4
    )
    head, *rows = csv.reader((tmp_path / "p.csv").read_text().splitlines())
    assert head[0] == "t [s]" and "above | below friction [J]" in head and len(rows) == trajectory.t.size
    nd.simulate(nd.scenes.load("slide")(), 0.1, dt=1e-2).save("slide.h5")
    row = run("energy", "slide.h5", "--by", "pair")[1].splitlines()[1]
    assert row.split()[3] == "0.0000e+00" and float(row.split()[4]) < -0.5  # friction, and of impacts round-off
    found = json.loads(run("energy", "run.h5", "--by", "body", "--json")[1])
    assert found["series"]["ball"]["potential"] == trajectory.body_energies()["ball"][1].tolist()
    out = run("energy", "run.h5", "--by", "body")[1].splitlines()
    gained = {line.split()[0]: float(line.split()[-1]) for line in out[2:]}
    assert gained["all"] == pytest.approx(gained["below"] + gained["above"] + gained["ball"], abs=1e-3)


def test_run_tells_its_ledger(run):
    figures = json.loads(run("run", "slide", "--time", "0.02", "--json")[1])
    assert figures["ledger"]["t"][-1] == pytest.approx(0.02) and figures["ledger"]["kinetic"][0] == 2.0
    assert set(figures["shares"]) == {"physics", "numerics", "projection"}


def test_a_scene_of_ones_own(run, tmp_path):
    """It begins as the template, which runs, passes its audit, and is taken wherever a name is."""
    assert run("new", "my.py")[0] == 0
    code, out, _ = run("run", "my.py", "--time", "0.1", "--set", "slope=40", "--check", "-o", "my.h5")
    assert code == 0 and out.splitlines()[-1] == "my scene: passed, not audited: certificates, provenance"
    assert nd.Trajectory.load("my.h5").energy.kinetic[-1] > 0.1
    code, _, err = run("new", "my.py")
    assert code == 2 and "my.py exists" in err
    assert run("new", "my.txt")[0] == 2
    code, out, _ = run("sweep", "my.py", "--set", "mu=0.1,0.9", "--time", "0.05", "--workers", "1")
    assert code == 0 and [line.split()[0] for line in out.splitlines()[1:]] == ["0.1", "0.9"]


@pytest.mark.slow
def test_a_scene_of_ones_own_is_found_by_other_processes(run, tmp_path):
    run("new", "my.py")
    found = nd.sweep(nd.scenes.load("my.py"), {"mu": [0.1]}, 0.05, executor=1, keep=float_of_end, dt=5e-3)
    assert found[0].failure == ""


def test_scenes_without_a_name_are_called_after_their_files(run, tmp_path):
    """Their pages and figures can be told apart."""
    text = "import nsdyn\ndef scene():\n    a = nsdyn.Scene(NAME)\n    a.add_sphere('ball', 0.1, 1.0)\n    return a\n"
    for file, name, called in (("coin", "", "coin"), ("disk", "name='euler'", "euler")):
        (tmp_path / f"{file}.py").write_text(text.replace("NAME", name))
        assert run("run", f"{file}.py", "--time", "0.1", "--dt", "0.1", "-o", f"{file}.h5")[0] == 0
        assert nd.Trajectory.load(f"{file}.h5").meta["scene_name"] == called
    assert nd.scenes.load("coin.py")().name == "coin"


def test_the_template_runs_with_its_lines_uncommented(run, tmp_path):
    """Both functions: the crate is pushed, and what drives robots finds none."""
    run("new", "my.py")
    lines = (tmp_path / "my.py").read_text().splitlines()
    begin = next(k for k, line in enumerate(lines) if line.startswith("# def "))
    taken = [re.sub(r"^# (?=def |    )", "", line) for line in lines[begin:]]
    assert sum(line.startswith("def ") for line in taken) == 2
    (tmp_path / "my.py").write_text("\n".join(lines[:begin] + taken))
    code, _, err = run("run", "my.py", "--time", "0.3", "-o", "my.h5")
    assert (code, err) == (0, "") and nd.Trajectory.load("my.h5").energy.external.sum() > 0.0


SCENE = """import nsdyn as nd
DURATION = DT = 0.1
def scene(mass=1.0):
    out = nd.Scene()
    out.add_sphere("ball", 0.1, mass)
    return out
"""


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "def controller(scene):\n    return lambda t, q, v: {'a': PD()}",
            "line 8: NameError: name 'PD' is not defined",
        ),
        (
            "def external_force(scene): pass",
            "line 7: external_force(scene) must return a function of (t, q, v), got None",
        ),
        ("def controller(scene): 1 / 0", "line 7: ZeroDivisionError: division by zero"),
        (
            "def external_force(scene):\n    return lambda t, q, v: None",
            "line 8: external_force must return a mapping of",
        ),
        (
            "def external_force(scene):\n    return lambda t: {}",
            "line 8: external_force must be a function of (t, q, v), or of (t, q, v, last), or None, as",
        ),
        (
            "def external_force(scene):\n    return lambda t, q, v: {'bal': (0, 0, 1)}",
            "line 8: did you mean 'ball'? body of external_force must be",
        ),
        (
            "def external_force(scene):\n    return lambda t, q, v: nd.PD(-1, 0, 0)",
            "line 8: kp of a PD control must not be",
        ),
        ("def scene(): pass", "line 7: scene must return a nsdyn.Scene, got None"),
        ("def scene(): raise KeyError('x')", "line 7: KeyError: 'x'"),
        ("def scene():\n    out = nd.Scene()\n    out.add_sphere('b', -1.0, 1.0)", "line 9: radius must be"),
    ],
)
def test_mistakes_in_functions_of_scene_files(run, tmp_path, text, words):
    """In one line, which begins with the user's; in a sweep too."""
    (tmp_path / "bad.py").write_text(f"{SCENE}{text}\n")
    for command in (["run", "bad.py", "-o", "bad.h5"], ["sweep", "bad.py", "--workers", "1"]):
        code, out, err = run(*command)
        assert code == 2 and out == "" and err.startswith(f"nsdyn: error: bad.py, {words}") and err.count("\n") == 1


def test_mistakes_in_functions_of_sweeps():
    def make(mu):
        return None

    line = make.__code__.co_firstlineno
    with pytest.raises(ValueError, match=f"test_outputs.py, line {line}: scene must return a nsdyn.Scene, got None"):
        nd.sweep(make, {"mu": [0.5]}, 0.1)
    with pytest.raises(ValueError, match=r"test_outputs.py, line \d+: ZeroDivisionError: division by zero"):
        nd.sweep("slide", {"mu": [0.5]}, 0.02, dt=0.01, keep=lambda run: 1 / 0)


def float_of_end(trajectory):
    return float(trajectory.energy.kinetic[-1])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("def scene(:", "bad.py, line 1: "),
        ("import nsdyn\nscene = nothing", "bad.py, line 2: NameError: name 'nothing' is not defined"),
        ("DT = 1", "bad.py must define a function scene(...) that returns a Scene; see 'nsdyn new'"),
        ("def scene(): pass\nDT = 1", "bad.py must define DURATION, how long to simulate in s"),
        ("def scene(mu): pass\nDT = DURATION = 1", "parameter mu of scene in bad.py must have a default"),
        ("def scene(): return 1\nDT = DURATION = 1", "bad.py, line 1: scene must return a nsdyn.Scene, got 1"),
    ],
)
def test_scene_files_with_mistakes(run, tmp_path, text, words):
    (tmp_path / "bad.py").write_text(text)
    code, out, err = run("run", "bad.py")
    assert code == 2 and out == "" and words in err and len(err.splitlines()) == 1


def test_a_scene_file_need_not_say_how_long(run, tmp_path):
    (tmp_path / "bare.py").write_text(SCENE.replace("DURATION = DT = 0.1", ""))
    assert run("run", "bare.py", "--time", "0.02", "--dt", "0.01")[0] == 0
    assert run("sweep", "bare.py", "--time", "0.02", "--dt", "0.01", "--workers", "1", "--set", "mass=1,2")[0] == 0
    assert run("study", "bare.py", "--time", "0.02", "--dt", "0.01,0.005")[0] == 0
    for command in ("run", "sweep"):
        code, out, err = run(command, "bare.py", "--time", "0.02")
        assert code == 2 and out == "" and "bare.py must define DT, the time step in s, or --dt give it" in err
    code, out, err = run("study", "bare.py", "--dt", "0.01,0.005")
    assert code == 2 and out == "" and "bare.py must define DURATION, how long to simulate in s, or --time give" in err
    setup = nd.scenes.setup("bare.py")
    assert nd.simulate(setup.scene, 0.02, **setup.options(dt=0.01)).steps == 2
    with pytest.raises(ValueError, match=r"bare\.py must define DT"):
        setup.options()


def test_scene_file_that_is_not_there(run):
    code, _, err = run("run", "none.py")
    assert code == 2 and "no such scene file" in err


# -- runs beside each other --------------------------------------------------------------------------------------------


def test_order_of_exact_powers():
    """Errors C (h^p - h0^p) of any p give that p; errors that do not shrink, or are nothing, give none."""
    h1, h2, h0 = 4e-3, 2e-3, 5e-4
    for p in (0.5, 1.0, 2.0, 4.0, 6.0):
        e1, e2 = (3.0 * (h**p - h0**p) for h in (h1, h2))
        assert order(e1, e2, h1, h2, h0) == pytest.approx(p, rel=1e-9)  # round-off of the differences
    assert np.isnan([order(1.0, 1.0, h1, h2, h0), order(0.0, 1.0, h1, h2, h0), order(1e-3, 1.0, h1, h2, h0)]).all()


@pytest.mark.slow
def test_study_finds_the_order(run, tmp_path):
    """Fourth order of a free articulation, second order of a loop, against the finest run."""
    found = json.loads(run("study", "double_pendulum", "--dt", "4e-3,8e-3,5e-4", "--time", "0.4", "--json")[1])
    assert [row["dt"] for row in found["runs"]] == [8e-3, 4e-3, 5e-4] and found["runs"][1]["steps"] == 100
    for name in ("position", "rotation", "velocity", "energy"):
        assert found["runs"][0]["orders"][name] == pytest.approx(4.0, abs=0.2), name
        assert found["runs"][2][name] == 0.0
    code, out, _ = run("study", "four_bar", "--dt", "8e-3,4e-3,2e-3", "--time", "0.2", "--csv", "s.csv")
    assert code == 0 and out.splitlines()[-1] == "four_bar: largest differences from the run at dt = 0.002 s"
    coarse = next(csv.DictReader((tmp_path / "s.csv").read_text().splitlines()))
    assert float(coarse["dt [s]"]) == 8e-3 and float(coarse["time [s]"]) > 0.0
    assert float(coarse["order_position"]) == pytest.approx(2.0, abs=0.1)
    text = out.splitlines()[1].split()
    assert float(text[2]) == pytest.approx(float(coarse["position [m]"]), rel=1e-2)
    found = json.loads(run("study", "slide", "--dt", "1e-2,5e-3,1e-3", "--time", "0.1", "--json")[1])
    coarse = found["runs"][0]  # exact at any step: round-off has no order
    assert 0.0 < coarse["velocity"] < 1e-11 and set(coarse["orders"].values()) == {None}


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--dt", "1e-2"], "error: --dt must be at least two different positive numbers"),
        (
            ["--dt", "1e-2,7e-3", "--time", "0.1"],
            "must be a whole number of every dt, got 0.1 s and dt = 0.007",
        ),
        (["--dt", "1e-2,fine"], "--dt must be a number, got 'fine'"),
        (["--dt", "1e-2,0"], "error: --dt must be at least two different positive numbers"),
    ],
)
def test_bad_studies(run, arguments, words):
    code, out, err = run("study", "slide", *arguments)
    assert code == 2 and out == "" and words in err


def test_comparison_finds_where_runs_part(run):
    """Two boxes slide alike until one of them meets its wall, 3 mm later in one run: at 1 m/s, in step 21 and 24."""

    def scene(gap):
        out = nd.Scene()
        out.add_halfspace("ground", material=nd.Material(0.0))
        out.add_box("box", (0.2, 0.2, 0.2), 1.0, position=(0, 0, 0.1), linear_velocity=(1, 0, 0))
        out.add_box("wall", (0.2, 0.2, 0.4), position=(0.2 + gap, 0, 0.2), fixed=True)
        out.add_sphere("ball", 0.1, 1.0, position=(0, 5, 1.0))
        return out

    one, other = (nd.simulate(scene(gap), 0.05, dt=1e-3) for gap in (0.0205, 0.0235))
    found = nd.compare(one, other)
    assert found.times == 51 and found.identical == 21 and found.options == {}
    assert found.touching == (pytest.approx(0.021), "box", "wall")
    assert found.largest["position"] == pytest.approx(3e-3, abs=1e-5)
    level, t, body = found.parted[-1]
    assert (level, body) == (1e-3, "box") and t == pytest.approx(0.022)
    one.save("one.h5")
    other.save("other.h5")
    assert json.loads(run("compare", "one.h5", "other.h5", "--json")[1])["identical"] == 21
    code, out, _ = run("compare", "one.h5", "one.h5")
    assert code == 0 and out.splitlines()[0] == "51 times in common, the states of the first 51 equal to the last bit"
    fine = nd.simulate(scene(0.0205), 0.05, dt=5e-4)
    halves = nd.compare(one, fine)
    assert halves.times == 51 and halves.options["dt"] == (1e-3, 5e-4) and halves.touching is None
    with pytest.raises(ValueError, match="the recordings share no moving body"):
        nd.compare(fine, nd.simulate(nd.scenes.load("stack")(height=2), 0.01))
    with pytest.raises(ValueError, match="the recordings have 12 and 6 velocities"):
        nd.compare(one, nd.simulate(nd.scenes.load("slide")(), 0.01))
    with pytest.raises(ValueError, match="two Trajectories must be compared, got 'run"):
        nd.compare(one, "run.h5")


# -- checks ------------------------------------------------------------------------------------------------------------


def test_check_of_a_recording_is_the_audit(trajectory, run):
    trajectory.save("run.h5")
    code, out, _ = run("check", "run.h5")
    assert code == 0 and out == f"{nd.check(trajectory)}\n"
    wrong = trajectory.q.copy()
    wrong[20:, 2] -= 1e-3  # into the ground
    broken = nd.Trajectory(trajectory.meta, trajectory.scene, trajectory.columns | {"q": wrong})
    broken.save("bad.h5")
    code, out, _ = run("check", "bad.h5", "--json")
    found = json.loads(out)
    assert code == 1 and not found["passed"] and not found["findings"]["overlap"]["passed"]
    assert found["findings"]["overlap"]["amount"] == pytest.approx(1e-3, rel=1e-6)


def test_slip_is_rubbed_against(trajectory):
    """The audit finds friction that is less than mu r_N against the slip, or turned away from it."""
    assert nd.check(trajectory)["slip"].worst < 1e-9
    for turn in (0.5, -1.0):
        impulse = trajectory.columns["contacts/impulse"].copy()
        impulse[:, 1:] *= turn
        bent = nd.Trajectory(trajectory.meta, trajectory.scene, trajectory.columns | {"contacts/impulse": impulse})
        assert not nd.check(bent)["slip"].passed


def test_check_of_a_robot(robot, run):
    """`robot.urdf`: a tag that is not used, links whose shapes overlap, a joint outside its limits."""
    path, (share,) = robot
    code, out, _ = run("check", path, "--package-dir", share, "--json")
    found = json.loads(out)
    assert found["name"] == "robot.urdf" and any("transmission" in note for note in found["unused"])
    (ja,) = (joint for joint in found["joints"] if joint["name"] == "robot/ja")
    assert (ja["lower"], ja["upper"], ja["effort"], ja["friction"], ja["damping"]) == (-1.0, 2.0, 9.0, 0.7, 0.5)
    assert [(body["mass"], body["fixed"]) for body in found["masses"]] == [(1.0, True)] + 3 * [(1.0, False)]
    assert code == 0 and found["missing"] == []
    path.write_text(path.read_text().replace('lower="-1" upper="2"', 'lower="0.5" upper="2"'))
    code, out, _ = run("check", path, "--package-dir", share)
    assert "4 kg in all, 1 kg of it fixed, moving from 1 to 1 kg" in out.splitlines()[0]
    assert "outside its limits: nothing" in out
    assert "note: starts outside its limits unless q is given: robot/ja at 0, from 0.5 to 2" in out
    code, out, _ = run("check", path, "--package-dir", share, "-q", "0,1,0,0")
    assert code == 1 and "outside its limits: robot/ja at 0, from 0.5 to 2" in out
    code, _, err = run("check", path)
    assert code == 2 and "box.stl" in err


def test_check_of_a_scene(run, tmp_path):
    code, out, _ = run("check", "stack", "--set", "height=3", "--json")
    found = json.loads(out)
    assert code == 0 and [body["mass"] for body in found["masses"]] == [1.0] * 3 and found["shapes"] == 4
    assert found["masses"][0]["moments"] == pytest.approx([0.2**2 / 6] * 3)
    (tmp_path / "deep.py").write_text(
        "from nsdyn import Scene\nDURATION = DT = 0.1\n\n\ndef scene(depth=0.03):\n    out = Scene(name='deep')\n"
        "    out.add_halfspace('ground')\n    out.add_sphere('ball', 0.1, 2.0, position=(0, 0, 0.1 - depth))\n"
        "    out.add_box('on', (0.2, 0.2, 0.2), 1.0, position=(0, 0, 0.29 - depth))\n    return out\n"
    )
    code, out, _ = run("check", "deep.py")
    assert code == 1 and out.splitlines()[-1] == "deep.py: FAILED"
    overlaps = [line for line in out.splitlines() if line.startswith("overlaps")]
    assert overlaps == [
        "overlaps at the start: ground and ball by 0.03 m",
        "overlaps at the start: ball and on by 0.01 m",
    ]
    code, _, err = run("check", "stak")
    assert code == 2 and "did you mean 'stack'" in err


# -- the interface -----------------------------------------------------------------------------------------------------


def test_times_of_a_study_are_without_its_start():
    """What the first step loads or compiles is no cost of a step."""
    waited = []

    def slow_at_first(t, q, v):
        if not waited:
            waited.append(time.sleep(0.5))
        return {}

    found = nd.refine(nd.scenes.load("slide"), [2e-2, 1e-2], 0.1, external_force=slow_at_first)
    assert waited and all(0.0 < row.time < 0.3 for row in found.rows)
    assert max(map(len, repr(found).splitlines())) <= 115  # a line of most terminals


def test_dir_and_help_show_the_interface():
    assert set(nd.__all__) < set(dir(nd)) and all(not name.startswith("_") or "__" in name for name in dir(nd))
    text = pydoc.render_doc(nd, renderer=pydoc.plaintext)
    for name in ("simulate", "Scene", "sweep", "refine", "compare", "check"):
        assert f"nd.{name}" in text, name


def test_reprs_are_short(trajectory):
    scene = nd.scenes.load("wall")()
    assert repr(scene) == "<Scene 'wall': 105 free bodies, 1 fixed, 0 articulations>"
    assert len(repr(trajectory)) < 100
    one = nd.Scene()
    one.add_sphere("ball", 0.1, 1.0)
    assert repr(one) == "<Scene 'scene': 1 free body, 0 fixed, 0 articulations>"
    assert repr(trajectory.energy).startswith("<Energy over 40 steps: ") and len(repr(trajectory.energy)) < 200
    assert repr(trajectory.solver).startswith("<SolverLog of 40 steps: 40 CONVERGED, ")
    assert repr(trajectory.body("ball")) == "<BodyMotion of 'ball': 41 states>"
    assert repr(trajectory.pair("above", "below")) == "<Pair 'above', 'below': 40 steps, 40 of them pushing>"
    assert repr(trajectory.gauss).startswith("<Gauss of 40 steps: bound up to ")
    stepper = nd.Stepper(scene, 1e-2)
    assert repr(stepper.get_state()) == "<State at t = 0 s, 630 velocities>"
    assert repr(stepper.step()).startswith("<Step to t = 0.01 s: ")
    assert repr(nd.Status.CONVERGED) == "<Status.CONVERGED: 0>"
