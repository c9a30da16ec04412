"""Performance profiles: the figures on made-up times, and the workers that time the solvers."""

import csv
import math
import os
import sys
from pathlib import Path

import numpy as np
import pytest
from test_problem import corner_box

import nsdyn as nd
from nsdyn.bench import profiles
from nsdyn.tools.workers import Worker
from nsdyn.view import panels

HANGS = """
import sys, time, json
sys.stdin.readline()
print(json.dumps({"event": "start"}), flush=True)
time.sleep(60)
"""
ANSWERS = """
import sys, time, json
sys.stdin.readline()
for words in {"event": "start"}, {"seconds": 1.0}:
    print(json.dumps(words), flush=True)
    time.sleep(0.2)
"""
DIES = "import os, sys; sys.stdin.readline(); os.abort()"


def run(problem, solver, seconds, solved=True):
    return profiles.Run(problem, 4, solver, solved, seconds, 7, 1e-9 if solved else 1.0, 1e-9, "")


@pytest.fixture
def folder(tmp_path):
    nd.fclib.write(tmp_path / "box.hdf5", corner_box()[0])
    nd.fclib.write(tmp_path / "slip.hdf5", corner_box(mu=0.1, push=(0.5, 0.2))[0])
    return tmp_path


@pytest.fixture
def made_up():
    """Three problems: a wins one, b wins one and misses one, nobody solves the third."""
    return profiles.Profile(
        1e-8,
        10.0,
        (
            run("p1", "a", 1.0),
            run("p2", "a", 6.0),
            run("p3", "a", math.inf, False),
            run("p1", "siconos b", 4.0),
            run("p2", "siconos b", 2.0),
            run("p3", "siconos b", 0.1, False),
        ),
    )


def test_figures(made_up):
    assert made_up.problems == ["p1", "p2", "p3"] and made_up.solvers == ["a", "siconos b"]
    np.testing.assert_array_equal(made_up.ratios, [[1, 4], [3, 1], [math.inf, math.inf]])
    np.testing.assert_allclose(made_up.rho(1.0), [1 / 3, 1 / 3])
    np.testing.assert_allclose(made_up.rho(3.0), [2 / 3, 1 / 3])
    np.testing.assert_allclose(made_up.rho(1e9), [2 / 3, 2 / 3])  # what nobody solves counts
    a, b = made_up.summary()
    assert a["solved"] == 2 and a["problems"] == 3
    assert a["mean_ratio"] == pytest.approx(math.sqrt(3)) and b["mean_ratio"] == 2.0
    # 1/4 and 3 against the peer.
    assert a["against_siconos"]["problems"] == 2 and a["against_siconos"]["largest_ratio"] == 3.0
    assert a["against_siconos"]["mean_ratio"] == pytest.approx(math.sqrt(0.75))
    assert "against_siconos" not in b
    lines = made_up.table().splitlines()
    assert lines[1].split() == ["a", "2/3", "0.33", "0.33", "0.67", "0.67", "1.73"]
    assert lines[-1].startswith("a against the best of siconos on 2 problems: time ratio 0.866")


def test_csv_and_plot(made_up, tmp_path):
    profiles.write_csv(tmp_path / "p.csv", [made_up])
    rows = list(csv.DictReader((tmp_path / "p.csv").read_text().splitlines()))
    assert len(rows) == 6 and rows[1]["seconds"] == "6.0" and rows[2]["seconds"] == "" and rows[2]["solved"] == "False"
    from matplotlib.figure import Figure

    assert made_up.plot(Figure().subplots(), legend=False).get_legend() is None
    axes = made_up.plot(Figure().subplots())
    for line, k in zip(axes.lines, (0, 1), strict=True):
        assert {"color": line.get_color(), "ls": line.get_linestyle()} == panels.look(k)
        x, y = line.get_data()
        for factor in (1.0, 2.9, 3.1, 4.1):
            assert y[np.searchsorted(x, factor, "right") - 1] == pytest.approx(made_up.rho(factor)[k])


@pytest.mark.slow
def test_solvers_are_judged_by_the_problem(folder):
    found = profiles.measure(folder, ["auto", "pgs"], tol=1e-8, limit=60.0)
    assert found.problems == ["box", "slip"] and found.solvers == ["auto", "pgs"]
    for r in found.runs:
        assert r.solved and r.error <= 1e-8 and r.contacts == 4 and r.seconds > 0, r
    # Nothing meets a millionth of round-off: the solvers answer, the judge refuses.
    hopeless = profiles.measure(folder, ["pgs"], tol=1e-22, limit=60.0)
    assert not any(r.solved for r in hopeless.runs) and all(0 < r.error < 1e-6 for r in hopeless.runs)
    assert math.isnan(hopeless.summary()[0]["mean_ratio"])
    assert hopeless.table().splitlines()[1].split()[:3] == ["pgs", "0/2", "0.00"]


@pytest.mark.slow
def test_all_solvers_and_small_problems(folder, monkeypatch):
    monkeypatch.setattr(profiles, "SOLVERS", {"auto": None, "pgs": None})
    nd.fclib.write(folder / "one.hdf5", nd.FC3D(np.eye(3), np.array([-1.0, 0.2, 0.0]), np.array([0.5])))
    found = profiles.measure(folder, ["pgs", "all"], limit=60.0, min_contacts=2)
    assert found.problems == ["box", "slip"] and found.solvers == ["pgs", "auto"]


def test_hanging_solver_is_ended():
    worker = Worker([sys.executable, "-c", HANGS], 0.0)
    assert worker.ask({}, 0.3) == {"failure": "no answer within 0.3 s"}
    assert worker._process is None


def test_crash_is_a_result_and_the_next_request_gets_a_new_process():
    worker = Worker([sys.executable, "-c", DIES], 0.0)
    for _ in range(2):
        assert worker.ask({}, 10.0)["failure"] == "the process died with exit code -6"


@pytest.mark.slow
def test_first_calls_may_compile_for_a_while():
    """The grace is spent once: a solver that hangs in every first call costs it once."""
    script = HANGS.replace('"start"', '"warm"')
    worker = Worker([sys.executable, "-c", script], 0.5)
    assert worker.ask({}, 0.1)["failure"] == "no answer within 0.6 s"
    assert worker.ask({}, 0.1)["failure"] == "no answer within 0.1 s"


def test_limits_may_be_longer_than_the_system_waits():
    worker = Worker([sys.executable, "-c", ANSWERS], 0.0)
    assert worker.ask({}, 1e30) == {"seconds": 1.0}
    worker.close()


@pytest.mark.parametrize(
    ("keywords", "words"),
    [
        ({"solvers": ["magic"]}, "solver must be one of"),
        ({"tol": 0.0}, "tol must be positive"),
        ({"limit": 0.0}, "limit must be a positive number of seconds, got 0.0"),
        ({"peers": ["ode"]}, "peer must be one of"),
    ],
)
def test_bad_arguments(folder, keywords, words):
    with pytest.raises(ValueError, match=words):
        profiles.measure(folder, **keywords)


def test_bad_folders(tmp_path):
    with pytest.raises(ValueError, match=r"no \*\.hdf5 files in"):
        profiles.measure(tmp_path)
    (tmp_path / "text.hdf5").write_text("text")
    with pytest.raises(ValueError, match=r"text\.hdf5 is not an HDF5 file"):
        profiles.measure(tmp_path)


def test_missing_peer_says_what_to_install(folder, monkeypatch):
    monkeypatch.setattr(profiles, "_SCRIPTS", Path(os.devnull).parent / "nowhere")
    with pytest.raises(ValueError, match="apt-get install python3-siconos"):
        profiles.measure(folder, peers=["siconos"])


def peer(label):
    """One solver of a peer, or skip."""
    name = label.split()[0]
    try:
        return next(player for player in profiles.PEERS[name]() if player.label == label)
    except ValueError as reason:
        pytest.skip(str(reason))


@pytest.mark.parametrize("label", ["siconos NSGS-NSN", "pinocchio ADMM-SPECTRAL"])
def test_peers_solve_the_same_problem(folder, tmp_path, label):
    """Order of contacts and of components, and the signs, are right if the answer solves our problem."""
    player = peer(label)
    problem = nd.fclib.read(folder / "slip.hdf5")
    worker = Worker(list(player.script), 0.0)
    try:
        found = player.play(worker, folder / "slip.hdf5", problem, 1e-6, 60.0, tmp_path)
    finally:
        worker.close()
    assert found.solved and found.error <= 1e-6 and found.solver == label, found
