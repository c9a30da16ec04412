"""Every option of every command, in calls that end well."""

import argparse
import importlib.util
import itertools
import json
import shutil

import numpy as np
import pytest
from test_problem import corner_box

import nsdyn as nd
from nsdyn import cli
from nsdyn.cli import command
from nsdyn.view import browser

SHORT = "--time 0.04 --dt 1e-2"
SOLVED = "--theta 0.6 --solver auto --tol 1e-9 --loose 1e-3"
MUJOCO = """<mujoco><worldbody><body pos="0 0 1"><joint name="knee" axis="0 1 0"/><geom size=".1" mass="1"/></body>
</worldbody><keyframe><key name="bent" qpos="0.5"/></keyframe></mujoco>"""
URDF = """<robot name="r"><link name="base"><inertial><mass value="1"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link></robot>"""

CALLS = {
    "scenes": ["--json"],
    "doctor": ["--json --compile"],
    "new": ["my.py"],
    "run": [
        f"slide --set mu=0.2 {SHORT} {SOLVED} --polish --on-fail raise -o new.h5 --json",
        "slide --time 0.08 --dt 1e-2 --resume plain.h5 --every 2 --no-contacts",
        f"slide {SHORT} --html new.html --check --dump-on-fail dumps",
    ],
    "sweep": [
        f"slide --set mu=0.2,0.3 {SHORT} {SOLVED} --polish --on-fail raise --workers 1"
        " --store s.jsonl --csv s.csv --plot s.pdf --json",
    ],
    "study": [
        f"slide --dt 2e-2,1e-2 --set mu=0.2 --time 0.04 {SOLVED} --on-fail ignore --csv t.csv --plot t.pdf --json",
    ],
    "check": [
        "slide --set mu=0.2 --json",
        "r.urdf --base free --package-dir . -q 0,0,1,0,0,0,1",
        "m.xml --keyframe bent",
    ],
    "solve": ["p.hdf5 --solver pgs --tol 1e-6 -o solved.hdf5 --json"],
    "profile": [
        ". --solver pgs --peer pinocchio --tol 1e-4 --min-contacts 1 --limit 5 --csv p.csv --plot p.png --json",
    ],
    "bench": ["slip --limit 2 --csv b.csv --plot b.png --json"],
    "energy": ["run.h5 --by pair --plot e.png --csv e.csv --json"],
    **{kind: [f"run.h5 --name * --step 2 --csv {kind}.csv"] for kind in ("bodies", "joints", "pairs", "contacts")},
    "view": ["run.h5 run.h5 -o v.html --forces point --fps 10", "run.h5 --png v.png --at 0.02"],
    "film": ["run.h5 run.h5 -o f.mp4 --size 200x100 --speed 0.1 --fps 10 --curves none --forces"],
    "compare": ["run.h5 run.h5 --json"],
    "plot": ["run.h5 -o k.pdf --kind speed --name arm/* --size 85x60 --style ggplot"],
}
LONG = "bench", "profile", "doctor", "sweep"
ELSEWHERE = {
    "--dask": "below: dask need not be installed",
    "--peer": "below: engines need not be installed",
    "--parquet": "below: pyarrow need not be installed",
}


def parsers():
    """The parser of every command."""
    (commands,) = (a for a in command.parser()._actions if isinstance(a, argparse._SubParsersAction))
    return commands.choices


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("options")
    setup = nd.scenes.setup("arm_pushes_box")
    nd.simulate(setup.scene, 0.04, **setup.options(dt=1e-2)).save(path / "run.h5")
    nd.simulate(nd.scenes.load("slide")(), 0.04, dt=1e-2, every=2, contacts=False, record=path / "plain.h5")
    nd.fclib.write(path / "p.hdf5", corner_box(mu=0.1, push=(0.5, 0.2))[0])
    (path / "m.xml").write_text(MUJOCO)
    (path / "r.urdf").write_text(URDF)
    return path


def test_no_option_is_left_out():
    assert set(CALLS) == set(parsers())
    for name, parser in parsers().items():
        given = {word for call in CALLS[name] for word in call.split()} | ELSEWHERE.keys() | {"-h"}
        left = [a.option_strings for a in parser._actions if a.option_strings and not given & set(a.option_strings)]
        assert not left, f"nsdyn {name}: {left}"


def test_help_tells_of_files_where_some_are_written_and_of_problems_where_they_are_dumped():
    for name, parser in parsers().items():
        told = " ".join(parser.format_help().split())
        writes = any(kind in told for kind in ("--output", "--csv", "--html", "--plot"))
        assert ("Output files that exist are overwritten" in told) == writes, name
        assert ("write its problem" in told) == ("dump" in told), name


@pytest.mark.parametrize(
    "call",
    [
        # What others of them do is in tests of their own, too.
        pytest.param(f"{name} {call}", marks=pytest.mark.slow if name in LONG or "--png" in call else [])
        for name, calls in CALLS.items()
        for call in calls
    ],
)
def test_options(folder, monkeypatch, capsys, call):
    from nsdyn import compilation
    from nsdyn.bench import cases

    name, *words = call.split()
    if name == "film" and not shutil.which("ffmpeg"):
        pytest.skip("no ffmpeg")
    if name in ("film", "view") and browser.chromium() is None:
        pytest.skip("no Chromium")
    monkeypatch.chdir(folder)
    monkeypatch.setattr(cases, "STEPS", (0.5,))
    compiled: list[bool] = []
    monkeypatch.setattr(compilation, "compile_all", lambda: compiled.append(True))
    code = cli.main([name, *words])
    out, err = capsys.readouterr()
    assert code == 0, err
    assert bool(compiled) == ("--compile" in words)
    if "--json" in words:
        json.loads(out)
    for option in ("-o", "--csv", "--plot", "--store", "--html", "--png"):
        if option in words:
            assert (folder / words[words.index(option) + 1]).stat().st_size > 0


def test_options_of_the_scheme_and_the_solver_arrive(folder, monkeypatch):
    monkeypatch.chdir(folder)
    options = f"slide --set mu=0.2 {SHORT} {SOLVED} --polish --on-fail raise".split()
    assert cli.main(["run", *options, "-o", "scheme.h5"]) == 0
    assert cli.main(["sweep", *options, "--workers", "1", "--store", "scheme.jsonl"]) == 0
    head = json.loads((folder / "scheme.jsonl").read_text().partition("\n")[0])["sweep"]["options"]
    for found in (nd.Trajectory.load("scheme.h5").meta, head):
        assert (str(found["theta"]), str(found["polish"])) == ("0.6", "True")
        assert found["solver"].startswith("Auto(tol=1e-09, loose=0.001,")
    assert head["on_fail"] == "raise"


@pytest.mark.parametrize("call", ["profile . --limit -1", "bench slip --limit -1"])
def test_a_limit_of_time_arrives(folder, monkeypatch, capsys, call):
    monkeypatch.chdir(folder)
    assert cli.main(call.split()) == 2
    assert "limit must be a positive number of seconds, got -1.0" in capsys.readouterr().err


def test_a_study_obeys_its_options(capsys):
    """It has the errors of the same study in Python, whose options change them."""
    call = "study slide --dt 2e-2,1e-2 --time 0.04 --json --solver pgs --theta 0.6 --set mu=0.3".split()

    def errors(*more):
        assert cli.main([*call, *more]) == 0
        return [run["velocity"] for run in json.loads(capsys.readouterr().out)["runs"]]

    solver = nd.solvers.by_name("pgs", 1e-3)
    found = nd.refine("slide", [2e-2, 1e-2], 0.04, {"mu": 0.3}, theta=0.6, solver=solver)
    assert errors("--tol", "1e-3") == [row.velocity for row in found.rows]
    plain = nd.refine("slide", [2e-2, 1e-2], 0.04, {"mu": 0.3}, theta=0.6)
    assert errors("--tol", "1e-3") != [row.velocity for row in plain.rows]
    assert cli.main([*call, "--tol", "1e-300", "--on-fail", "ignore"]) == 0
    capsys.readouterr()
    assert cli.main([*call, "--tol", "1e-300", "--on-fail", "raise"]) == 1
    out, err = capsys.readouterr()
    assert out == "" and err.startswith("nsdyn: not converged: step 1 ") and err.count("\n") == 1


def test_a_study_takes_all_steps_that_are_given(capsys):
    """Lists that are given twice add up, as those of other commands do."""
    assert cli.main("study slide --dt 2e-2,1e-2 --dt 5e-3 --time 0.04 --json".split()) == 0
    assert [row["dt"] for row in json.loads(capsys.readouterr().out)["runs"]] == [2e-2, 1e-2, 5e-3]


def test_a_study_takes_what_is_loose():
    """A tolerance that no machine meets is missed, and the loose one is met or missed."""
    call = "study slide --dt 2e-2,1e-2 --time 0.04 --tol 1e-300 --on-fail raise".split()
    assert [cli.main([*call, "--loose", loose]) for loose in ("1e-3", "1e-300")] == [0, 1]


def test_a_check_shows_the_keyframe(folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    for options, angle in (([], "0"), (["--keyframe", "bent"], "0.5")):
        assert cli.main(["check", "m.xml", *options]) == 0
        *_, joint = (line for line in capsys.readouterr().out.splitlines() if line.startswith("robot/knee "))
        assert joint.split()[1] == angle


@pytest.mark.parametrize("kind", ["bodies", "joints", "pairs", "contacts"])
def test_parquet_has_the_headers_of_csv(folder, monkeypatch, kind):
    parquet = pytest.importorskip("pyarrow.parquet")
    monkeypatch.chdir(folder)
    assert cli.main([kind, "run.h5", "--parquet", f"{kind}.parquet", "--csv", f"{kind}.csv"]) == 0
    names = parquet.read_table(f"{kind}.parquet").column_names
    assert (folder / f"{kind}.csv").read_text().partition("\n")[0] == ",".join(names)
    assert "t [s]" in names


def test_bench_beside_another_engine(monkeypatch, capsys):
    from nsdyn.bench import cases, engines

    monkeypatch.setattr(cases, "STEPS", (0.5,))
    code = cli.main(["bench", "slip", "--peer", "mujoco", "--limit", "2"])
    out, err = capsys.readouterr()
    if engines.PEERS["mujoco"].installed:
        assert code == 0 and "mujoco" in out
    else:
        assert code == 2 and "peer mujoco is not installed: pip install 'nsdyn[peers]'" in err


@pytest.mark.filterwarnings("default")  # dask's own
def test_sweep_on_a_scheduler_of_dask(capsys):
    call = ["sweep", "slide", "--set", "mu=0.2,0.3", *SHORT.split(), "--json", "--dask"]
    if importlib.util.find_spec("distributed") is None:
        assert cli.main([*call, "tcp://127.0.0.1:8786"]) == 2
        assert "--dask needs the extra `cluster`: pip install 'nsdyn[cluster]'" in capsys.readouterr().err
        return
    from distributed import LocalCluster

    with LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster:
        code = cli.main([*call, cluster.scheduler_address])
    out, err = capsys.readouterr()
    assert code == 0, err
    assert [run["mu"] for run in json.loads(out)["runs"]] == [0.2, 0.3]


def test_a_tolerance_without_its_sign_is_told(folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    calls = ("run slide", "sweep slide", "study slide --dt 1e-2,2e-2")
    for call, option in itertools.product(calls, ("--tol", "--loose")):
        assert cli.main([*call.split(), "--time", "0.04", option, "1e8"]) == 2
        said = f"did you mean 1e-08? {option} must be at most 1 m/s, got 1e+08"
        assert said in capsys.readouterr().err


def test_round_off_of_a_sweep_is_shown_as_none(folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    assert cli.main(["sweep", "slide", "--set", "mu=0.5", "--time", "0.6", "--dt", "1e-2", "--workers", "1"]) == 0
    head, row = capsys.readouterr().out.splitlines()
    cells = [cell for cell in head.split("  ") if cell]  # two blanks or more are between them
    shown = dict(zip((cell.strip() for cell in cells), row.split(), strict=True))
    assert shown["kinetic [J]"] == "0" and np.isclose(float(shown["displacement [m]"]), 0.407, atol=0.01)


@pytest.mark.parametrize(
    "given", ["run slide --set=--", "run slide -o--", "bodies run.h5 --csv=--", "view run.h5 --at=--"]
)
def test_two_hyphens_are_no_value(given, capsys):
    """Of which argparse makes an empty list."""
    with pytest.raises(SystemExit) as stop:
        cli.main(given.split())
    assert stop.value.code == 2 and "expected one argument" in capsys.readouterr().err
