"""The command: what it prints, what it writes, and how it says no."""

import argparse
import csv
import importlib.metadata
import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
import warnings
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from test_problem import corner_box

import nsdyn as nd
from nsdyn.audit.findings import TOLERANCES
from nsdyn.cli import doctor, output
from nsdyn.cli.command import EXAMPLES, parser
from nsdyn.recording import file
from nsdyn.recording.trajectory import Trajectory
from nsdyn.scene import settings
from nsdyn.view import browser, viewer

SHORT = ["--time", "0.02", "--dt", "1e-3"]


@pytest.fixture
def recording(run, tmp_path):
    assert run("run", "slide", *SHORT, "-o", "run.h5")[0] == 0
    return tmp_path / "run.h5"


@pytest.mark.parametrize("command", [[], *([name] for name in EXAMPLES)])
def test_help(run, command):
    code, out, err = run(*command, "--help")
    assert code == 0 and out.startswith("usage: nsdyn") and err == ""


def test_without_a_command_it_helps(run):
    code, out, err = run()
    assert (code, out, err) == (0, run("--help")[1], "")
    assert all(f"\n                {example}\n" in out for example in EXAMPLES.values())


def test_every_command_has_an_example():
    commands = next(action for action in parser()._actions if isinstance(action, argparse._SubParsersAction))
    assert set(commands.choices) == set(EXAMPLES)


@pytest.mark.parametrize("name", list(EXAMPLES))
def test_examples_are_of_their_command(name):
    """And can be typed."""
    program, *words = shlex.split(EXAMPLES[name])
    assert program == "nsdyn" and words[0] == name
    assert callable(parser().parse_args(words).run)


def test_version(run):
    assert run("--version")[1] == f"nsdyn {nd.__version__}\n"


def test_as_a_module():
    command = [sys.executable, "-m", "nsdyn", "--version"]
    assert nd.__version__ in subprocess.run(command, capture_output=True, text=True, check=True).stdout


def test_help_loads_no_heavy_package():
    code = """
import sys
from nsdyn import cli
try:
    cli.main(["--help"])
except SystemExit:
    heavy = {"numpy", "numba", "pinocchio", "coal", "h5py", "scipy"}
    print(*sorted(heavy & set(sys.modules)), file=sys.stderr)
"""
    root = str(Path(nd.__file__).parents[1])
    done = subprocess.run([sys.executable, "-c", code], cwd=root, capture_output=True, text=True)
    assert done.stdout.startswith("usage: nsdyn") and done.stderr == "\n"


def test_scenes(run):
    code, out, err = run("scenes")
    assert code == 0 and err == ""
    assert [line.partition(":")[0] for line in out.splitlines()[::2]] == nd.scenes.names()
    found = json.loads(run("scenes", "--json")[1])
    assert found["slide"]["parameters"]["mu"] == 0.5 and found["slide"]["summary"]
    assert f"mu={found['slide']['parameters']['mu']}" in out


def test_doctor(run, monkeypatch):
    code, out, _ = run("doctor", "--json")
    figures = json.loads(out)
    assert code == 0 and figures["ok"]
    assert figures["packages"]["numpy"] == {"version": np.__version__, "file": np.__file__}
    assert set(figures["checks"].values()) == {"ok"}
    monkeypatch.setattr(doctor, "CHECKS", dict([*doctor.CHECKS.items()][:1]))  # each of which is a process
    out = run("doctor")[1]
    assert all(word in out for word in ("pin ", "coal", "qdldl", "cache", "chromium", "check"))


def test_doctor_survives_packages_that_are_broken(run, tmp_path, monkeypatch):
    """One that ends the process, one that solves wrongly and one that does not load, each in its line."""
    (tmp_path / "coal.py").write_text("import os, signal\nos.kill(os.getpid(), signal.SIGKILL)\n")
    (tmp_path / "qdldl.py").write_text(
        "class Solver:\n    def __init__(self, A): ...\n    def solve(self, b): return b\n"
    )
    (tmp_path / "numba.py").write_text("1 / 0\n")
    monkeypatch.syspath_prepend(tmp_path)
    code, out, _ = run("doctor", "--compile")  # which is left out
    assert code == 1
    for line in ("coal distance: ended by SIGKILL", "qdldl solve: WRONG RESULT", "sliding contact: ZeroDivisionError"):
        assert line in out


def test_doctor_survives_without_numpy(run, tmp_path, monkeypatch):
    (tmp_path / "numpy.py").write_text("raise ModuleNotFoundError('No module named numpy')\n")
    monkeypatch.syspath_prepend(tmp_path)
    code, out, _ = run("doctor")
    assert code == 1 and out.count(": ModuleNotFoundError: No module named numpy\n") == len(doctor.CHECKS)


def test_doctor_misses_a_package(run, monkeypatch):
    monkeypatch.setitem(doctor.PACKAGES, "no-such-distribution", "no_such_module")
    monkeypatch.setattr(doctor, "CHECKS", {})
    code, out, _ = run("doctor")
    assert code == 1 and "no-such-distribution MISSING" in out
    assert "no-such-distribution is missing: its module no_such_module is not found" in out


def test_doctor_names_what_is_mixed_or_old(monkeypatch):
    """A module that comes from another place than its distribution, one that no distribution brought, one too old."""
    assert not doctor.wrong_packages()
    monkeypatch.setattr(doctor, "PACKAGES", {"numpy": "json", "no-such-distribution": "json", "scipy": "scipy"})
    monkeypatch.setattr(
        importlib.metadata, "requires", lambda _: ["numpy>=999", "scipy<1,>=0.1", "h5py>=1; extra == 'x'"]
    )
    mixed, stray, old, new = doctor.wrong_packages()
    assert re.fullmatch(r"numpy is mixed: .* is installed in .*, .*json.* is imported", mixed)
    assert re.fullmatch(r"no-such-distribution is not installed as a package, but json is found at .*", stray)
    assert re.fullmatch(r"numpy is [\d.]+, >=999 is needed", old)
    assert re.fullmatch(r"scipy is [\d.]+, <1,>=0.1 is needed", new)


def test_run_of_what_rests_says_so(run):
    """In the words of the page, in place of a table of round-off; JSON has them as a key."""
    code, out, _ = run("run", "stack", "--time", "0.02")
    assert code == 0 and out.startswith("at rest: nothing of 98.1 J moves\nmax |defect| ") and "physics" not in out
    assert json.loads(run("run", "stack", "--time", "0.02", "--json")[1])["at_rest"] is True
    assert run("run", "heavy_on_light", "--time", "0.02")[1].startswith("at rest: nothing of 2.944 kJ moves")
    assert json.loads(run("run", "slide", *SHORT, "--json")[1])["at_rest"] is False


def test_run_prints_records_and_draws(run, tmp_path):
    code, out, err = run("run", "slide", *SHORT, "--set", "mu=0.25", "-o", "run.h5", "--html", "run.html")
    assert code == 0 and err == ""
    trajectory = Trajectory.load(tmp_path / "run.h5")
    assert trajectory.steps == 20 and trajectory.dt == 1e-3
    assert set(trajectory.columns["contacts/mu"]) == {0.25}
    lines = out.splitlines()
    assert "\n".join(lines[:-1]) == trajectory.energy_table()
    assert lines[-1].startswith("20 steps to 1e-08; ") and "4.0 contacts on average" in lines[-1]
    assert (tmp_path / "run.html").read_text() == viewer.html(trajectory)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["run.h5", "run.html"]


def test_run_gives_its_figures_as_json(run, tmp_path):
    code, out, _ = run(
        "run",
        "slide",
        *SHORT,
        "--theta",
        "0.6",
        "--solver",
        "newton",
        "--tol",
        "1e-7",
        "--json",
        "-o",
        "run.h5",
    )
    figures = json.loads(out)
    trajectory = Trajectory.load(tmp_path / "run.h5")
    assert code == 0 and figures["steps"] == 20 and figures["contacts"] == 4.0
    assert figures["worst"] == trajectory.worst()
    assert figures["parameters"]["speed"] == 2.0 and figures["recording"] == "run.h5"
    assert trajectory.meta["theta"] == 0.6
    assert trajectory.meta["solver"].startswith("Newton(tol=1e-07")


def test_run_goes_on(run, tmp_path):
    """With every second step, without contacts; other options are refused in one line, as are two files."""
    slide = "run", "slide", "--dt", "1e-3", "--every", "2", "--no-contacts"
    assert run(*slide, "--time", "0.01", "-o", "run.h5")[0] == 0
    code, out, _ = run(*slide, "--time", "0.02", "--resume", "run.h5", "--json")
    figures = json.loads(out)
    assert code == 0 and figures["steps"] == 20 and figures["every"] == 2 and figures["recording"] == "run.h5"
    assert figures["contacts"] is None and figures["start_up_time"] is None and figures["worst"]["penetration"] is None
    assert Trajectory.load(tmp_path / "run.h5").steps == 10
    code, out, _ = run(*slide, "--time", "0.02", "--resume", "run.h5")
    assert code == 0 and out.splitlines()[-1].startswith("10 times 2 steps to 1e-08; ")
    assert "since it was resumed, contacts not recorded" in out
    code, out, err = run(*slide, "--time", "0.03", "--theta", "0.6", "--resume", "run.h5")
    assert code == 2 and out == "" and err.endswith("run.h5 cannot be resumed: its option theta is 0.5, not 0.6\n")
    assert run(*slide, "--resume", "run.h5", "-o", "other.h5")[0] == 2


def test_run_is_audited(run, tmp_path, monkeypatch):
    code, out, _ = run("run", "slide", *SHORT, "--check")
    assert code == 0 and out.splitlines()[-1] == "slide: passed, not audited: certificates, provenance"
    monkeypatch.setitem(TOLERANCES, "overlap", -1.0)
    code, out, _ = run("run", "slide", *SHORT, "--check", "--json")
    audit = json.loads(out)["audit"]
    assert code == 1 and not audit["passed"] and not audit["findings"]["overlap"]["passed"]


def test_run_of_a_driven_scene(run, tmp_path):
    """The module's external_force is applied: the push does work."""
    code, _, _ = run("run", "rolling", "--time", "0.05", "--dt", "0.01", "--set", "balls=2", "-o", "run.h5")
    assert code == 0
    assert Trajectory.load(tmp_path / "run.h5").energy.external.sum() > 0.1


@pytest.mark.filterwarnings("default:step")
def test_run_that_does_not_converge_keeps_its_steps(run, tmp_path):
    # No solver reaches 1e-300 once something moves.
    impossible = "--solver", "pgs", "--tol", "1e-300"
    code, out, err = run("run", "slide", *SHORT, *impossible, "-o", "all.h5")
    assert code == 0 and err.startswith("nsdyn: warning: step 1 from t = ") and err.count("\n") == 1
    assert "missed their tolerance" in out and Trajectory.load(tmp_path / "all.h5").steps == 20
    code, out, err = run("run", "slide", *SHORT, *impossible, "--on-fail", "raise", "-o", "run.h5")
    assert code == 1 and out == ""
    assert err.startswith("nsdyn: not converged: step 1 from t = ") and err.count("\n") == 1
    assert "run.h5" in err and Trajectory.load(tmp_path / "run.h5").steps < 20


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["fly"], "COMMAND must be one of"),
        (["rnu", "slide"], "did you mean 'run'?"),
        (["run", "slide", "--on-fail", "rise"], "did you mean 'raise'?"),
        (["run", "no_such_scene"], "scene must be one of"),
        (["run", "slid"], "error: did you mean 'slide'? scene must be one of slide, "),
        (["run", "tower"], " others; got 'tower'; 'nsdyn scenes' lists them all"),
        (["run", "text.h5"], "text.h5 is no scene: give a name that 'nsdyn scenes' lists, or a scene file, which ends"),
        (["sweep", "text.h5"], "text.h5 is no scene"),
        (["check", "README.md"], "README.md is no robot file (.urdf, "),
        (["check", "missing.h5"], "no such recording: missing.h5"),
        (["run", "slide", "--dt", "1e9"], "error: --time must be at least half a step of dt = 1e+09 s, got 0.6 s"),
        (["run", "slide", "--time", "1e-12"], "--time must be at least half a step of dt = 0.001 s, got 1e-12 s"),
        (
            ["run", "slide", "--set", "colour=1"],
            "parameter of scene slide must be one of mu, speed,",
        ),
        (["run", "slide", "--set", "mu"], "--set expects NAME=VALUE"),
        (["sweep", "slide", "--set", "mu=0.2", "--set", "mu=0.3"], "--set expects every name once"),
        (["run", "slide", "--set", "mu=much"], "mu must be a number, got 'much'"),
        (["run", "slide", "--set", "mu=-1"], "mu must not be negative"),
        (["run", "stack", "--set", "height=2.5"], "height must be a whole number, got '2.5'"),
        (["run", "slide", "--time", "soon"], "invalid float value"),
        (["run", "slide", "--time", "-1"], "error: --time must be a positive"),
        (["run", "slide", "--dt", "0"], "dt must be a positive"),
        (["run", "slide", "--theta", "0.2"], "theta must lie in"),
        (["run", "slide", "--solver", "magic"], "solver must be one of"),
        (["run", "slide", "--tol", "0"], "tol must be positive"),
        (["run", "slide", "-o", "missing/run.h5"], "cannot write missing/run.h5: there is no folder"),
        (["run", "slide", "-o", "run.h5", "--html", "missing/run.html"], "cannot write missing/run.html"),
        (["run", "slide", "-o", "."], "cannot write .: it is a folder"),
        (["solve", "missing.hdf5"], "no such file: missing.hdf5"),
        (["solve", "."], "cannot read .: it is a folder"),
        (["view", "."], "cannot read .: it is a folder"),
        (["solve", "text.h5"], "text.h5 is not an HDF5 file"),
        (["solve", "text.h5", "--solver", "magic"], "solver must be one of"),
        (["solve", "text.h5", "--tol", "-1"], "tol must be positive"),
        (["solve", "text.h5", "-o", "missing/s.hdf5"], "cannot write missing/s.hdf5: there is no folder"),
        (["solve", "text.h5", "-o", "text.h5"], "cannot write text.h5: it is read"),
        (["profile", "."], "no *.hdf5 files in ."),
        (["bench", "sleigh"], "case must be one of slide"),
        (["bench", "--peer", "ode"], "peer must be one of"),
        (["profile", ".", "--plot", "missing/p.png"], "cannot write missing/p.png: there is no folder"),
        (["energy", "missing.h5"], "no such file: missing.h5"),
        (["energy", "text.h5", "--csv", "e.csv"], "text.h5 is not a recording of nsdyn"),
        (["view", "text.h5"], "text.h5 is not a recording of nsdyn"),
        (["view", "missing.h5"], "no such file: missing.h5"),
        (["plot", "missing.h5", "-o", "text.h5"], "no such file: missing.h5"),
        (["compare", "text.h5", "missing.h5"], "no such file: missing.h5"),
        (["view", "text.h5", "-o", "run.html", "--at", "1"], "--at is the time of the picture"),
        (["view", "text.h5", "-o", "run.html"], "text.h5 is not a recording of nsdyn"),
        (["view", "text.h5", "--png", "frame.jpg"], "cannot write frame.jpg: a picture must be png, got .jpg"),
        (["film", "text.h5", "-o", "run.avi"], "cannot write run.avi: a film must be mp4, got .avi"),
        (["film", "text.h5", "text.h5", "-o", "text.h5"], "cannot write text.h5: it is read"),
        (["film", "text.h5", "missing.h5"], "no such file: missing.h5"),
        (["film", "text.h5", "--size", "720"], "--size must be WIDTHxHEIGHT in pixels, such as 1280x720, got 720"),
        (["film", "text.h5", "--size", "1280.5x720"], "--size must be WIDTHxHEIGHT in pixels"),
        (["film", "text.h5", "--size", "721x400"], "size must be two even numbers of pixels of 100 to 8000, got"),
        (["film", "text.h5", "--speed", "0"], "speed must be positive, got 0.0"),
        (["film", "text.h5", "--fps", "nan"], "fps must be positive, got nan"),
        (["energy", "text.h5", "--plot", "e.xyz"], "a picture must be png or pdf or svg, got .xyz"),
        (["energy", "text.h5", "--csv", "text.h5"], "cannot write text.h5: it is read"),
        (["run", "slide", "-o", "run.h5", "--html", "run.h5"], "cannot write run.h5: it is named twice"),
        (["run", "slide", "-o", "-"], "cannot record in -: it is no regular file"),
        (["run", "slied"], "did you mean 'slide'?"),
        (["run", "slide", "--solver", "newtn"], "did you mean 'newton'?"),
        (["run", "slide", "--set", "Mu=1"], "did you mean 'mu'?"),
        (["run", "stack", "--set", "height=-3"], "height must be at least 1, got -3"),
        (["run", "slide", "--set", "speed=1e200"], "must be finite and at most 1e+50 in size"),
        (["run", "slide", "--set", "mass=1e-300"], "mass of 'box' must be positive, at least 1e-50, got 1e-300"),
    ],
)
def test_bad_input_is_told_in_one_line_and_leaves_nothing(run, tmp_path, arguments, message):
    (tmp_path / "text.h5").write_text("text")
    code, out, err = run(*arguments)
    assert code == 2 and out == ""
    assert err.startswith("nsdyn: error: ") and err.count("\n") == 1
    assert message in err
    assert [p.name for p in tmp_path.iterdir()] == ["text.h5"]


def test_bad_input_leaves_existing_files(run, tmp_path):
    (tmp_path / "run.h5").write_text("precious")
    assert run("run", "slide", "--theta", "2", "-o", "run.h5")[0] == 2
    assert (tmp_path / "run.h5").read_text() == "precious"


@pytest.fixture
def problem(tmp_path):
    path = tmp_path / "p.hdf5"
    nd.fclib.write(path, corner_box(mu=0.1, push=(0.5, 0.2))[0])
    return path


def test_solve(run, problem, tmp_path):
    code, out, err = run("solve", "p.hdf5", "-o", "s.hdf5")
    assert code == 0 and err == "" and out.startswith("4 contacts, auto: converged; error ") and out.count("\n") == 1
    given = nd.fclib.read(problem)
    r = nd.fclib.read_solution(tmp_path / "s.hdf5").r
    assert given.error(r) <= 1e-8 and (nd.fclib.read(tmp_path / "s.hdf5").W != given.W).nnz == 0
    code, out, _ = run("solve", "p.hdf5", "--solver", "pgs", "--tol", "1e-6", "--json")
    figures = json.loads(out)
    assert code == 0 and figures["converged"] and figures["contacts"] == 4 and figures["error"] <= 1e-6
    assert figures["residual"] <= 1e-6 and figures["iterations"] > 0 and figures["time"] > 0


def test_times_have_the_unit_that_suits_them():
    given = {17.4e-6: "17.4 µs", 0.99999e-3: "1 ms", 41.26e-3: "41.3 ms", 13.2: "13.2 s", 1234.5: "1234 s"}
    assert {time: output.seconds(time) for time in given} == given


def test_solve_that_does_not_converge(run, problem):
    code, out, err = run("solve", "p.hdf5", "--solver", "pgs", "--tol", "1e-300")
    assert code == 1 and "the residual no longer falls" in out and err == ""


def test_solve_without_a_slater_point(run, tmp_path):
    """A point squeezed between two walls: no solution exists, and the one line says why."""
    H = np.hstack((np.eye(3), -np.eye(3)))
    squeezed = nd.FC3D(H.T @ H, np.array([-1.0, 0, 0, -1.0, 0, 0]), np.full(2, 0.5))
    nd.fclib.write(tmp_path / "squeezed.hdf5", squeezed)
    code, out, _ = run("solve", "squeezed.hdf5")
    assert code == 1 and "no velocity opens every contact" in out and out.count("\n") == 1


@pytest.mark.slow
@pytest.mark.filterwarnings("default:step")
def test_failing_run_dumps_a_problem_that_solve_reads(run):
    code, _, err = run("run", "slide", *SHORT, "--solver", "pgs", "--tol", "1e-300", "--dump-on-fail", "dumps")
    assert code == 0 and "its problem is in dumps/step-000001.hdf5" in err
    code, out, _ = run("solve", "dumps/step-000001.hdf5", "--json")
    assert code == 0 and json.loads(out)["contacts"] == 4


@pytest.mark.slow
def test_profile(run, problem, tmp_path):
    tolerances = ("--tol", "1e-4", "--tol", "1e-8")
    code, out, err = run("profile", ".", "--solver", "pgs", *tolerances, "--csv", "p.csv", "--plot", "p.png")
    assert code == 0 and err == ""
    lines = out.splitlines()
    assert lines[0] == "tol 0.0001" and lines[4] == "tol 1e-08"
    assert lines[2].split() == lines[6].split() == ["pgs", "1/1", "1.00", "1.00", "1.00", "1.00", "1"]
    rows = list(csv.DictReader((tmp_path / "p.csv").read_text().splitlines()))
    assert [row["tol"] for row in rows] == ["0.0001", "1e-08"]
    assert rows[1]["problem"] == "p" and rows[1]["solved"] == "True"
    assert (tmp_path / "p.png").read_bytes().startswith(b"\x89PNG")
    (figures,) = json.loads(run("profile", ".", "--solver", "pgs", "--tol", "1e-30", "--json")[1])
    assert figures["summary"][0]["solved"] == 0 and figures["summary"][0]["mean_ratio"] is None
    assert figures["runs"][0]["error"] > 1e-30
    code, _, err = run("profile", ".", "--min-contacts", "20")
    assert code == 2 and "no problem in . has 20 contacts" in err
    assert run("profile", ".", "--min-contacts", "-1")[0] == 2


@pytest.mark.slow
def test_bench(run, monkeypatch):
    from nsdyn.bench import cases

    monkeypatch.setattr(cases, "STEPS", (0.5, 0.2))
    code, out, _ = run("bench", "slip", "--csv", "b.csv", "--plot", "b.png")
    assert code == 0 and out.splitlines()[2].split()[:2] == ["slip", "nsdyn"]
    assert Path("b.csv").read_text().count("\n") == 1 + 2 * 2 and Path("b.png").stat().st_size > 5_000
    figures = json.loads(run("bench", "slip", "--json")[1])
    assert figures["summary"][0]["reached"]["nsdyn"]["error"] < 1e-10 and figures["summary"][0]["ratio"] is None


@pytest.mark.parametrize(
    ("text", "default", "value"),
    [
        ("3", 1, 3),
        ("3", 1.0, 3.0),
        ("1e-3", 1.0, 1e-3),
        ("true", False, True),
        ("False", True, False),
        ("3", "a", "3"),
    ],
)
def test_values_take_the_type_of_their_default(text, default, value):
    parsed = settings.parse(text, default, "name")
    assert parsed == value and type(parsed) is type(value)


def test_truth_is_true_or_false():
    with pytest.raises(ValueError, match="name must be true or false, got '1'"):
        settings.parse("1", True, "name")


def test_energy(run, recording, tmp_path):
    trajectory = Trajectory.load(recording)
    code, out, err = run("energy", "run.h5", "--plot", "e.png", "--csv", "e.csv")
    assert code == 0 and err == "" and out == trajectory.energy_table() + "\n"
    assert (tmp_path / "e.png").read_bytes().startswith(b"\x89PNG")

    head, *rows = csv.reader((tmp_path / "e.csv").read_text().splitlines())
    assert head[:4] == ["step", "t [s]", "kinetic [J]", "potential [J]"] and len(rows) == 21
    table = np.array(rows, dtype=float)[:, 1:]
    np.testing.assert_array_equal(table[:, 1], trajectory.energy.kinetic)  # 17 digits are exact
    np.testing.assert_array_equal(table[1:, -1], trajectory.energy.defect)
    # Energies of a few joules: the ledger of every line closes to their round-off.
    np.testing.assert_allclose(np.diff(table[:, 1:3].sum(axis=1)), table[1:, 3:].sum(axis=1), rtol=0, atol=1e-14)

    figures = json.loads(run("energy", "run.h5", "--json")[1])
    assert figures["worst"] == trajectory.worst() and figures["at_play"] == trajectory.at_play
    assert figures["shares"]["physics"]["total"] == trajectory.shares()["physics"][0]
    assert figures["shares"]["numerics"]["share"] < 1e-12
    assert figures["ledger"]["friction"][-1] == pytest.approx(trajectory.energy.friction.sum(), rel=1e-12)


def test_truncated_recording(run, recording, monkeypatch):
    """One line, without waiting, by every command that reads it."""
    waited = []
    monkeypatch.setattr(time, "sleep", waited.append)
    with open(recording, "r+b") as file:
        file.truncate(recording.stat().st_size // 2)
    for command in (["energy", "run.h5"], ["view", "run.h5", "-o", "run.html"]):
        code, out, err = run(*command)
        assert code == 2 and out == "" and err.startswith("nsdyn: error: run.h5 is damaged") and err.count("\n") == 1
        assert not waited


def test_a_recording_without_a_step(run, recording):
    """As of a run that was killed in its first."""
    meta, scene, columns, _ = file.read_state(Path(recording))
    file.create(Path("begun.h5"), (meta, scene, file.until(columns, 0)), grow=True)
    assert run("bodies", "begun.h5") == (2, "", "nsdyn: error: begun.h5 has no steps\n")
    assert run("energy", "begun.h5")[0] == 0


def test_dash_is_stdout(run, recording, tmp_path):
    run("energy", "run.h5", "--csv", "e.csv")
    code, out, err = run("energy", "run.h5", "--csv", "-")
    assert code == 0 and out == (tmp_path / "e.csv").read_text()
    assert err == Trajectory.load(recording).energy_table() + "\n"


@pytest.mark.slow
def test_existing_outputs_are_overwritten(run, problem, recording, tmp_path):
    for *arguments, name in (
        ["run", "slide", *SHORT, "-o", "out.h5"],
        ["run", "slide", *SHORT, "--html", "out.html"],
        ["sweep", "slide", *SHORT, "--set", "mu=0.2,0.3", "--workers", "1", "--csv", "sweep.csv"],
        ["profile", ".", "--solver", "pgs", "--csv", "profile.csv"],
        ["solve", "p.hdf5", "-o", "out.hdf5"],
        ["energy", "run.h5", "--csv", "energy.csv"],
        ["energy", "run.h5", "--plot", "out.png"],
        ["view", "run.h5", "-o", "view.html"],
    ):
        (tmp_path / name).write_text("old")
        assert run(*arguments, name)[0] == 0 and (tmp_path / name).read_bytes()[:3] != b"old"
        assert "that exist are overwritten" in " ".join(run(arguments[0], "--help")[1].split())


def test_timings_leave_start_up_apart(run, monkeypatch):
    """A first step that waits for a compiler changes the start-up alone: by a clock on which only steps take time."""
    real, clock, done = nd.Stepper.step, [0.0], []

    def step(self):
        clock[0] += 0.01 if done else 3.01
        done.append(self)
        return real(self)

    monkeypatch.setattr(nd.Stepper, "step", step)
    monkeypatch.setattr(time, "perf_counter", lambda: clock[0])
    figures = json.loads(run("run", "slide", *SHORT, "--json")[1])
    assert figures["start_up_time"] == pytest.approx(3.0) and figures["median_step_time"] == pytest.approx(0.01)
    assert figures["wall_time"] == pytest.approx(3.0 + 0.01 * figures["steps"])
    done.clear()
    assert "(median step 10.00 ms) after 3.00 s of start-up" in run("run", "slide", *SHORT)[1].splitlines()[-1]


def test_view(run, recording, tmp_path):
    assert run("view", "run.h5", "-o", "run.html", "--forces", "--fps", "100") == (0, "", "")
    assert (tmp_path / "run.html").read_text() == viewer.html(Trajectory.load(recording), fps=100, forces=True)
    assert run("view", "run.h5") == (0, "run.html\n", "")
    assert (tmp_path / "run.html").read_text() == viewer.html(Trajectory.load(recording))
    code, _, err = run("view", "run.h5", "-o", "new.html", "--fps", "0")
    assert code == 2 and "fps must be positive" in err and not (tmp_path / "new.html").exists()


@pytest.mark.slow
def test_view_of_two(run, recording, tmp_path):
    assert run("run", "slide", "--time", "0.04", "--dt", "1e-2", "-o", "other.h5")[0] == 0
    assert run("view", "run.h5", "other.h5", "-o", "both.html") == (0, "", "")
    both = [Trajectory.load(tmp_path / name) for name in ("run.h5", "other.h5")]
    assert (tmp_path / "both.html").read_text() == viewer.html(both[0], beside=both[1])
    code, _, err = run("view", "run.h5", "missing.h5", "-o", "new.html")
    assert code == 2 and "no such file: missing.h5" in err and not (tmp_path / "new.html").exists()


def test_film_without_ffmpeg(run, recording, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    code, _, err = run("film", "run.h5")
    assert code == 2 and "films need ffmpeg on the PATH" in err and err.count("\n") == 1


@pytest.mark.slow
@pytest.mark.skipif(not (browser.chromium() and shutil.which("ffprobe")), reason="no Chromium or no ffmpeg")
def test_film_has_the_size_speed_and_pictures_asked_for(run, recording, tmp_path):
    words = ["--size", "400x300", "--speed", "0.05", "--fps", "10", "--curves", "motion", "--forces", "point"]
    assert run("film", "run.h5", "run.h5", "run.h5", *words) == (0, "run.mp4\n", "")
    probe = ["ffprobe", "-v", "error", "-count_frames", "-of", "json"]
    probe += ["-show_entries", "stream=width,height,nb_read_frames,r_frame_rate,codec_name", "run.mp4"]
    (found,) = json.loads(subprocess.run(probe, capture_output=True, check=True).stdout)["streams"]
    pictures = round(Trajectory.load("run.h5").t[-1] / (0.05 / 10)) + 1
    assert found == {
        "codec_name": "h264",
        "width": 400,
        "height": 300,
        "r_frame_rate": "10/1",
        "nb_read_frames": str(pictures),
    }


@pytest.mark.slow
@pytest.mark.skipif(not (browser.chromium() and shutil.which("ffmpeg")), reason="no Chromium or no ffmpeg")
def test_film_has_the_curves_and_forces_asked_for(run, recording):
    def seen(*words):
        """The last picture, in greys."""
        assert run("film", "run.h5", "--size", "300x200", "--speed", "0.2", "-o", "f.mp4", *words) == (0, "", "")
        greys = ["ffmpeg", "-v", "error", "-i", "f.mp4", "-f", "rawvideo", "-pix_fmt", "gray", "-"]
        shown = subprocess.run(greys, capture_output=True, check=True).stdout
        return np.frombuffer(shown, dtype=np.uint8).reshape(-1, 200, 300)[-1].astype(int)

    energy, motion, bare = seen(), seen("--curves", "motion"), seen("--curves", "none")
    forces = seen("--curves", "none", "--forces")
    apart = [(np.abs(a - b) > 60).sum() for a, b in ((energy, bare), (energy, motion), (forces, bare))]
    # Of 60 000: curves, other curves, an arrow with its legend on the box.
    assert apart[0] > 6000 and apart[1] > 1000 and 200 < apart[2] < 6000


@pytest.mark.skipif(browser.chromium() is None, reason="no Chromium on the PATH")
def test_view_takes_a_picture(run, recording, tmp_path):
    assert run("view", "run.h5", "--png", "frame.png", "--at", "0.01") == (0, "", "")
    assert (tmp_path / "frame.png").read_bytes().startswith(b"\x89PNG")
    code, _, err = run("view", "run.h5", "--png", "late.png", "--at", "1")
    assert code == 2 and "at must lie between 0 and 0.02 s" in err
    assert sorted(p.name for p in tmp_path.iterdir()) == ["frame.png", "run.h5"]


def test_picture_without_a_browser(run, recording, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    code, _, err = run("view", "run.h5", "--png", "frame.png")
    assert code == 2 and "apt-get install chromium" in err and err.count("\n") == 1


def test_warnings_are_one_line(run, monkeypatch):
    real = nd.simulate

    def simulate(*arguments, **keywords):
        warnings.warn("boxes overlap\nby 1 mm", stacklevel=2)
        return real(*arguments, **keywords)

    monkeypatch.setattr(nd, "simulate", simulate)
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        code, _, err = run("run", "slide", *SHORT)
    assert code == 0 and err == "nsdyn: warning: boxes overlap by 1 mm\n"


def test_interruption(run, monkeypatch):
    def simulate(*arguments, **keywords):
        raise KeyboardInterrupt

    monkeypatch.setattr(nd, "simulate", simulate)
    hook = sys.unraisablehook
    assert run("run", "slide") == (130, "", "nsdyn: interrupted\n")
    assert sys.unraisablehook is hook


def test_an_interrupt_where_an_object_is_freed_is_not_lost(tmp_path):
    """Python drops what is raised there, and tells a traceback."""
    (tmp_path / "mine.py").write_text(
        "import nsdyn as nd\n\n\n"
        "class Freed:\n    def __del__(self):\n        raise KeyboardInterrupt\n\n\n"
        "def scene():\n    Freed()\n    return nd.scenes.load('slide')()\n"
    )
    command = [sys.executable, "-m", "nsdyn", "run", "mine.py", "--time", "30", "--dt", "1e-4"]
    heard = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)  # a shell ignores it in what runs in its background
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120, preexec_fn=heard)
    assert done.returncode == 130
    assert done.stderr.splitlines()[-1].startswith("nsdyn: interrupted") and "Traceback" not in done.stderr


def test_an_interrupted_run_goes_on(run, tmp_path, monkeypatch):
    real, count = nd.Stepper.step, [0]

    def step(stepper):
        count[0] += 1
        if count[0] > 4:
            raise KeyboardInterrupt
        return real(stepper)

    asked = "run", "slide", "--time", "0.1", "--dt", "0.01"
    with monkeypatch.context() as patch:
        patch.setattr(nd.Stepper, "step", step)
        code, out, err = run(*asked, "-o", "run.h5")
    assert (code, out) == (130, "")
    assert err == "nsdyn: interrupted: the steps before it are in run.h5; --resume run.h5 goes on\n"
    assert nd.Trajectory.load("run.h5").steps == 4
    assert run(*asked, "--resume", "run.h5")[0] == 0
    assert nd.Trajectory.load("run.h5").steps == 10


def test_an_interrupt_before_the_first_step_promises_no_recording(run, tmp_path, monkeypatch):
    def begin(*arguments, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr(nd.Stepper, "__init__", begin)
    for _ in range(2):  # without a file, and with one of another run
        assert run("run", "slide", "-o", "run.h5") == (130, "", "nsdyn: interrupted\n")
        (tmp_path / "run.h5").write_bytes(b"of another run")


def test_a_locale_that_is_not_utf8(tmp_path):
    """The text of nsdyn has letters such as √ and µ, its code too."""
    root = str(Path(nd.__file__).parents[1])
    environment = {
        **{name: text for name, text in os.environ.items() if not name.startswith(("LC_", "LANG"))},
        **{"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "PYTHONPATH": root},
    }
    for words in ("profile --help", "new my.py", "run my.py --time 0.1"):
        command = [sys.executable, "-m", "nsdyn", *words.split()]
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True)
        assert done.returncode == 0, done.stderr


def test_reader_that_goes_away():
    root = str(Path(nd.__file__).parents[1])
    command = [sys.executable, "-u", "-m", "nsdyn", "scenes"]
    with subprocess.Popen(command, cwd=root, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        process.stdout.close()
        err = process.stderr.read()
    assert process.returncode == 1 and err == b""
