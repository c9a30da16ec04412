"""Sweeps: every combination once, in order, with the same bits from every executor."""

import contextlib
import csv
import importlib.util
import json
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest

import nsdyn as nd
from nsdyn import cli
from nsdyn.study import gathering
from nsdyn.study import sweep as ensemble
from nsdyn.study.store import Store


def len_of(trajectory):
    return trajectory.steps


def end(trajectory):
    return trajectory.q[-1]


# From 21 bricks on their coordinates are too many for the dense factorisation.
VALUES = {"mu": [0.3, 0.6], "rows": [3, 4], "columns": [7]}
OPTIONS = {"duration": 0.1, "dt": 0.01}


@pytest.fixture(scope="module")
def serial():
    return nd.sweep("wall", VALUES, **OPTIONS)


def test_members_are_the_product_in_order(serial):
    assert [m.parameters for m in serial] == [{"mu": m, "rows": r, "columns": 7} for m in (0.3, 0.6) for r in (3, 4)]
    for m in serial:
        assert m.failure == "" and m.result.steps == 10
        # The wall of the named scene, alone.
        alone = nd.simulate(nd.scenes.load("wall")(**m.parameters), **OPTIONS)
        np.testing.assert_array_equal(m.result.q, alone.q)
        np.testing.assert_array_equal(m.result.energy.friction, alone.energy.friction)


@pytest.mark.parametrize("kind", ["threads", pytest.param("processes", marks=pytest.mark.slow)])
def test_same_bits_from_every_executor(serial, kind):
    """A function of a named scene goes to other processes by its name; what `keep` makes of a run comes back."""
    pool = ThreadPoolExecutor(4) if kind == "threads" else ProcessPoolExecutor(1, get_context("spawn"))
    with pool:
        found = nd.sweep(nd.scenes.load("wall"), VALUES, executor=pool, keep=end, **OPTIONS)
    for one, other in zip(serial, found, strict=True):
        assert one.parameters == other.parameters
        np.testing.assert_array_equal(one.result.q[-1], other.result)


@pytest.mark.skipif(importlib.util.find_spec("distributed") is None, reason="dask is not installed (extra `cluster`)")
@pytest.mark.filterwarnings("default")  # dask's own
def test_same_bits_from_dask(serial):
    from distributed import Client, LocalCluster

    with (
        LocalCluster(n_workers=1, threads_per_worker=2, dashboard_address=None) as cluster,
        Client(cluster) as client,
        client.get_executor() as executor,
    ):
        found = nd.sweep("wall", VALUES, executor=executor, keep=end, **OPTIONS)
    for one, other in zip(serial, found, strict=True):
        np.testing.assert_array_equal(one.result.q[-1], other.result)


def killed_once(trajectory):
    """Kills its worker in the fifth run, the first time."""
    marker = Path(os.environ["NSDYN_TEST_MARKER"])
    if trajectory.v[0, 0] == 5.0 and not marker.exists():
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return float(trajectory.q[-1, 0])


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("distributed") is None, reason="dask is not installed (extra `cluster`)")
@pytest.mark.filterwarnings("default")  # dask's own
def test_nothing_is_lost_with_a_worker_of_dask(tmp_path, monkeypatch):
    """Two workers, one of which is killed on the way: all 300 runs are there, with the bits of one process."""
    from distributed import Client, LocalCluster

    monkeypatch.setenv("NSDYN_TEST_MARKER", str(tmp_path / "marker"))
    values = {"speed": np.arange(1.0, 301.0).tolist()}
    with (
        LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        Client(cluster) as client,
        client.get_executor() as executor,
    ):
        found = nd.sweep("slide", values, 0.02, executor=executor, keep=killed_once, dt=0.01)
    assert (tmp_path / "marker").exists()
    alone = nd.sweep("slide", values, 0.02, keep=killed_once, dt=0.01)
    assert [m.failure for m in found] == [""] * 300
    assert [m.result for m in found] == [m.result for m in alone]


def loses(*values):
    raise RuntimeError(f"lost {values}")


def test_a_message_that_is_lost_is_sent_again_one_by_one(monkeypatch):
    """An executor that loses whatever comes with task 3: only that is lost, and what failed is told."""
    monkeypatch.setattr(gathering, "MESSAGES", 4)

    class Lossy(ThreadPoolExecutor):
        def submit(self, function, *arguments):
            lost = (3,) in arguments[1]
            return super().submit(loses if lost else function, *arguments)

    with Lossy(2) as executor:
        found = sorted(gathering.gather(abs, {k: (k,) for k in range(10)}, executor))
    assert [k for k, _, _ in found] == list(range(10))
    assert [(k, out) for k, out, reason in found if not reason] == [(k, k) for k in range(10) if k != 3]
    assert found[3][1] is None and found[3][2].startswith("its worker was lost twice: RuntimeError: lost ")


def test_a_run_that_does_not_converge_loses_only_itself():
    """Nothing reaches 1e-300, but a ball in flight need not."""
    solver = nd.solvers.by_name("pgs", 1e-300)
    flying, sliding = nd.sweep(
        lambda name: nd.scenes.load(name)(), {"name": ["bounce", "slide"]}, 0.02, solver=solver, on_fail="raise"
    )
    assert flying.failure == "" and flying.result.steps == 20
    assert sliding.result is None and "did not converge" in sliding.failure


def test_bad_arguments():
    for values in ([], 0.3, "0.3"):
        with pytest.raises(ValueError, match="mu must have a list of at least one value"):
            nd.sweep("slide", {"mu": values}, 0.1)
    with pytest.raises(ValueError, match="scene must be one of"):
        nd.sweep("sleigh", {"mu": [0.3]}, 0.1)
    with pytest.raises(ValueError, match="mu"), ThreadPoolExecutor(1) as pool:
        nd.sweep("slide", {"mu": [-1.0]}, 0.1, executor=pool)
    for executor in (0, True, 1.5, "two"):
        with pytest.raises(ValueError, match=f"executor must be a number of processes, .*, got {executor!r}"):
            nd.sweep("slide", {"mu": [0.3]}, 0.1, executor=executor)
    with pytest.raises(ValueError, match="progress must be True or False, got 'no'"):
        nd.sweep("slide", {"mu": [0.3]}, 0.02, progress="no")
    with pytest.raises(ValueError, match=r"^keep must be a function, got 5$"):
        nd.sweep("slide", {"mu": [0.3]}, 0.02, dt=0.01, keep=5)
    for call in (nd.sweep, lambda **given: nd.refine(**given, dts=[0.02, 0.01])):
        with pytest.raises(ValueError, match=r"^scene must be a function, got <Scene 'scene'"):
            call(scene=nd.Scene(), parameters={}, duration=0.1)
        with pytest.raises(ValueError, match=r"^parameters must be a mapping of names to .*values, got \[0.3\]"):
            call(scene="slide", parameters=[0.3], duration=0.1)
        for duration in ("0.1", np.inf, np.nan, None):
            with pytest.raises(ValueError, match=f"^duration must be a positive number of seconds, got {duration!r}"):
                call(scene="slide", parameters={}, duration=duration)


def test_a_run_that_is_refused_loses_only_itself():
    good, bad = nd.sweep("slide", {"mu": [0.3, -1.0]}, 0.02, dt=0.01)
    assert good.failure == "" and bad.result is None and "mu must not be negative" in bad.failure


def dies(trajectory):
    """Kills its process where mu is 0.2, the first time only; where it is 0.4, always."""
    mu = trajectory.scene["geoms"][0]["mu"]
    marker = Path(os.environ["NSDYN_TEST_MARKER"])
    if mu == 0.4 or (mu == 0.2 and not marker.exists()):
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return float(mu)


@pytest.mark.slow  # it starts six processes
def test_a_process_that_dies_loses_its_run_only_and_that_is_tried_again(tmp_path, monkeypatch):
    monkeypatch.setenv("NSDYN_TEST_MARKER", str(tmp_path / "marker"))
    values = {"mu": [0.1, 0.2, 0.3, 0.4, 0.5]}
    store = tmp_path / "s.jsonl"
    found = nd.sweep("slide", values, 0.02, executor=2, keep=dies, dt=0.01, store=store)
    assert [m.result for m in found] == [0.1, 0.2, 0.3, None, 0.5]
    assert "its worker was lost twice: BrokenProcessPool" in found[3].failure
    # What was lost is not stored, and tried again.
    assert len(store.read_text().splitlines()) == 5


def counted(trajectory):
    with open(os.environ["NSDYN_TEST_MARKER"], "a") as file:
        file.write("x")
    return {"x": trajectory.q[-1, 0], "bad": float("nan")}


def test_what_cannot_be_sent_is_named():
    """Before a process is started; in this one it may stay."""
    calls = {"external_force": lambda t, q, v: {}, "keep": lambda run: run.steps}
    for name, given in calls.items():
        words = f"{name} can't be pickled, to be sent to other processes: define it at module level, got <function"
        with pytest.raises(ValueError, match=words):
            nd.sweep("slide", {"mu": [0.5]}, 0.02, executor=2, dt=0.01, **{name: given})
        with ProcessPoolExecutor(1) as executor, pytest.raises(ValueError, match=words):
            nd.sweep("slide", {"mu": [0.5]}, 0.02, executor=executor, dt=0.01, **{name: given})
    assert [run.result for run in nd.sweep("slide", {"mu": [0.5]}, 0.02, dt=0.01, **calls)] == [2]


def stopped(trajectory):
    """Ctrl-C in the third run."""
    if trajectory.meta["parameters"] == '{"mu": 0.3}' or trajectory.scene["geoms"][0]["mu"] == 0.3:
        raise KeyboardInterrupt
    return 1.0


def test_one_process_writes_a_store(tmp_path):
    store, options = tmp_path / "s.jsonl", {"duration": 0.02, "dt": 0.01, "keep": len_of}
    nd.sweep("slide", {"mu": [0.1]}, store=store, **options)
    before = store.read_bytes()
    head = json.loads(before.splitlines()[0])["sweep"]
    with Store(store, head), pytest.raises(ValueError, match=r"s\.jsonl is being written by another process"):
        nd.sweep("slide", {"mu": [0.1, 0.2]}, store=store, **options)
    assert store.read_bytes() == before
    assert len(nd.sweep("slide", {"mu": [0.1, 0.2]}, store=store, **options)) == 2
    assert len(store.read_bytes().splitlines()) == 3


def test_a_sweep_that_is_stopped_says_what_is_done(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(ensemble, "figures", stopped)
    values = "sweep", "slide", "--set", "mu=0.1,0.2,0.3,0.4", "--time", "0.02", "--dt", "0.01", "--workers", "1"
    assert cli.main([*values, "--store", str(tmp_path / "s.jsonl")]) == 130
    assert capsys.readouterr().err.splitlines()[-1] == "nsdyn: interrupted: 2 of 4 done; the same command goes on"
    assert len((tmp_path / "s.jsonl").read_bytes().splitlines()) == 3
    assert cli.main([*values]) == 130
    assert "2 of 4 done; without a store they are lost" in capsys.readouterr().err


def test_tasks_that_run_are_interrupted_where_no_more_are_wanted():
    begin = time.monotonic()
    outcomes = gathering.gather(time.sleep, {0: (0.0,), 1: (600.0,)}, 2)
    assert next(outcomes) == (0, None, "")
    outcomes.close()  # as Ctrl-C does
    assert time.monotonic() - begin < 60.0  # most of it the start of the processes
    assert not multiprocessing.active_children()


class Finalised:
    """What an interrupt meets where Python drops it."""

    def __init__(self, mark):
        self.mark = mark

    def __del__(self):
        Path(self.mark).touch()
        time.sleep(600.0)


def finalise(mark, first):
    if first:
        Finalised(mark)
        time.sleep(600.0)
    while not Path(mark).exists():
        time.sleep(0.01)


@pytest.mark.slow
def test_tasks_are_interrupted_again_where_an_interrupt_is_dropped(tmp_path, capfd):
    begin, mark = time.monotonic(), str(tmp_path / "mark")
    outcomes = gathering.gather(finalise, {0: (mark, True), 1: (mark, False)}, 2)
    assert next(outcomes) == (1, None, "")
    outcomes.close()
    assert time.monotonic() - begin < 60.0
    assert not multiprocessing.active_children()
    assert "KeyboardInterrupt" not in capfd.readouterr().err


@pytest.mark.slow
def test_ctrl_c_of_two_workers_loses_no_run_that_is_told(tmp_path):
    """As a terminal sends it, to all processes at once, in the midst of runs."""
    store = tmp_path / "s.jsonl"
    values = ["--set", "mu=" + ",".join(f"0.{k}" for k in range(2, 10)), "--time", "4", "--workers", "2"]
    command = [sys.executable, "-m", "nsdyn", "sweep", "slide", *values, "--store", str(store)]
    heard = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)  # a shell ignores it in what runs in its background
    pipes = {"stderr": subprocess.PIPE, "stdout": subprocess.PIPE}
    sweep = subprocess.Popen(command, **pipes, start_new_session=True, preexec_fn=heard)
    deadline = time.monotonic() + 120.0  # kernels may have to be compiled
    while not store.exists() or store.read_bytes().count(b"\n") < 3:
        assert time.monotonic() < deadline and sweep.poll() is None
        time.sleep(0.02)
    os.killpg(sweep.pid, signal.SIGINT)
    told = sweep.communicate(timeout=60)[1].decode()
    rows = store.read_bytes().splitlines()[1:]
    assert sweep.returncode == 130 and 2 <= len(rows) < 8
    assert told.splitlines()[-1] == f"nsdyn: interrupted: {len(rows)} of 8 done; the same command goes on"
    assert "Traceback" not in told
    subprocess.run(command, check=True, capture_output=True)
    after = store.read_bytes().splitlines()[1:]
    assert after[: len(rows)] == rows
    assert sorted(json.loads(row)["parameters"]["mu"] for row in after) == [float(f"0.{k}") for k in range(2, 10)]


@pytest.mark.parametrize(
    "delay", [0.0, pytest.param(600.0, marks=pytest.mark.slow)], ids=["between tasks", "in a task"]
)
def test_no_process_outlives_one_that_is_killed(delay, tmp_path):
    """They hold its output open, which is closed once all are gone."""
    script = f"""import os, signal, time
from nsdyn.study import gathering
if __name__ == "__main__":
    outcomes = gathering.gather(time.sleep, {{0: (0.0,), 1: (0.0,), 2: ({delay},), 3: ({delay},)}}, 2)
    next(outcomes), next(outcomes), print("begun", flush=True)
    {"next(outcomes), next(outcomes)" if delay == 0.0 else "time.sleep(0.5)"}
    os.kill(os.getpid(), signal.SIGKILL)
"""
    (tmp_path / "killed.py").write_text(script)
    parent = subprocess.Popen([sys.executable, tmp_path / "killed.py"], stdout=subprocess.PIPE, start_new_session=True)
    try:
        assert parent.communicate(timeout=20)[0] == b"begun\n" and parent.returncode == -signal.SIGKILL
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(parent.pid, signal.SIGKILL)


def component(axis):
    return lambda run: float(run.v[-1, axis])


def test_a_store_knows_functions_by_what_they_do(tmp_path):
    """Not by their names, which many lambdas share, and in another process by the same text."""
    store, options = tmp_path / "s.jsonl", {"duration": 0.02, "dt": 0.01}
    nd.sweep("slide", {"mu": [0.1]}, store=store, keep=lambda run: float(run.v[-1, 0]), **options)
    for keep in (lambda run: float(run.q[-1, 0]), component(0)):
        with pytest.raises(ValueError, match="is the store of another sweep: its keep is "):
            nd.sweep("slide", {"mu": [0.1]}, store=store, keep=keep, **options)


GAIN = 1.0


class Push:
    """A force with parameters, as a class."""

    def __init__(self, size):
        self.size = size

    def __call__(self, t, q, v):
        return {"box": [self.size * GAIN, 0.0, 0.0]}

    def held(self, t, q, v):
        return self(t, q, v)


class Slotted(Push):
    """A class whose own value is in a slot."""

    __slots__ = ("other",)

    def __init__(self, other):
        super().__init__(1)
        self.other = other


@dataclass(frozen=True)
class Course:
    values: np.ndarray

    def __call__(self, t, q, v):
        return {"box": [self.values[int(t)], 0.0, 0.0]}


def within(size):
    def inner():
        return size

    return lambda t, q, v: {"box": [inner(), 0.0, 0.0]}


def steps_at(k, x):
    """2000 numbers, all 0 but one, which NumPy does not print."""
    return np.where(np.arange(2000) == k, x, 0.0)


TWINS = (
    lambda x: (Push(x), Push(x).held, within(x), component(x), partial(component(0), x), Course(steps_at(900, x))),
    lambda x: (partial(min, steps_at(900, x)), Course(np.array([1.0 + 1e-12 * x])), partial(max, [within(x)])),
    lambda x: (Slotted(x),),
)


def test_a_store_knows_all_that_functions_use(monkeypatch):
    """Arguments that differ only in what they hold are told apart; equal ones are equal, in other processes too."""
    for make in TWINS:
        told = [list(map(ensemble.told, make(x))) for x in (1, 2, 1)]
        assert told[0] == told[2] and not set(told[0]) & set(told[1])
    one, other = (lambda run: 1.0), (lambda run: 2.0)  # of one line
    assert ensemble.told(one) != ensemble.told(other)
    here = [ensemble.told(f) for make in TWINS for f in make(1)]
    code = "import test_ensemble as t; print([t.ensemble.told(f) for make in t.TWINS for f in make(1)])"
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == f"{here}\n"
    before = ensemble.told(Push(1))
    monkeypatch.setitem(globals(), "GAIN", 2.0)
    assert ensemble.told(Push(1)) != before


def test_a_stored_sweep_goes_on(tmp_path, monkeypatch):
    """Runs that are stored are not run again, a line that a kill has cut is; another sweep is refused."""
    runs, store = tmp_path / "runs", tmp_path / "s.jsonl"
    monkeypatch.setenv("NSDYN_TEST_MARKER", str(runs))
    options = {"duration": 0.02, "dt": 0.01, "keep": counted, "store": store}
    first = nd.sweep("slide", {"mu": [0.1, 0.2]}, **options)
    assert runs.read_text() == "xx"
    lines = store.read_bytes().splitlines(keepends=True)
    store.write_bytes(b"".join(lines[:-1]) + lines[-1][:20])
    again = nd.sweep("slide", {"mu": np.array([0.1, 0.2, 0.3])}, **options)
    assert runs.read_text() == "xxxx" and store.read_bytes().startswith(b"".join(lines))
    for a, b in zip(first, again, strict=False):
        assert a.parameters == b.parameters and a.result["x"] == b.result["x"] and np.isnan(b.result["bad"])
    alone = nd.sweep("slide", {"mu": [0.3]}, 0.02, dt=0.01)[0].result
    assert again[2].result["x"] == alone.q[-1, 0]
    for others, words in (
        ({"dt": 0.02}, r"its options is .*'dt': '0.01'.*; give another name"),
        ({"duration": 0.03}, "its duration is 0.02, not 0.03"),
        ({"keep": end}, "its keep is "),
        ({"keep": None}, "keep must say what of a run is stored"),
    ):
        with pytest.raises(ValueError, match=words):
            nd.sweep("slide", {"mu": [0.1]}, **options | others)
    with pytest.raises(ValueError, match="is the store of another sweep: its "):
        nd.sweep("stack", {"mu": [0.1]}, **options)
    store.write_text("no store\n")
    with pytest.raises(ValueError, match=r"s\.jsonl is not the store of a sweep"):
        nd.sweep("slide", {"mu": [0.1]}, **options)
    with pytest.raises(ValueError, match="a store holds numbers, texts, lists and dicts of them: got Trajectory"):
        nd.sweep("slide", {"mu": [0.1]}, 0.02, dt=0.01, keep=lambda run: run, store=tmp_path / "other.jsonl")
    with pytest.raises(ValueError, match="a store holds numbers, texts, lists and dicts of them: got Material"):
        nd.sweep("slide", {"mu": [nd.Material()]}, 0.02, dt=0.01, keep=len_of, store=tmp_path / "third.jsonl")


def test_any_function_is_a_scene():
    (one,) = nd.sweep(lambda speed: nd.scenes.load("slide")(speed=speed), {"speed": [1.0]}, 0.05, dt=0.01)
    assert ensemble.figures(one.result)["displacement"] == pytest.approx(0.05 - 0.5 * 0.5 * 9.81 * 0.05**2)


ONE = "--workers", "1"


def run(capsys, *arguments):
    code = cli.main(["sweep", *arguments])
    return code, *capsys.readouterr()


SETTINGS = ["--set", "mu=0.1,0.2", "--set", "speed=1", "--time", "0.05", "--dt", "0.01"]


def test_command(capsys, tmp_path):
    code, out, _ = run(capsys, "slide", *SETTINGS, *ONE, "--csv", str(tmp_path / "s.csv"))
    lines = out.splitlines()
    assert code == 0 and len(lines) == 3 and lines[0].split()[:3] == ["mu", "speed", "displacement"]
    assert lines[2].split()[:3] == ["0.2", "1", f"{0.05 - 0.1 * 9.81 * 0.05**2:.6g}"]
    head, *rows = csv.reader((tmp_path / "s.csv").read_text().splitlines())
    units = {"displacement [m]", "kinetic [J]", "friction [J]", "gauss_bound [√J]", "residual [m/s]", "penetration [m]"}
    assert head[:3] == ["mu", "speed", "failure"] and units <= set(head) and len(rows) == 2
    assert all("[" in title for title in head[3:])
    # Text and JSON, stored and read from there: the same figures.
    found, *stored = told(capsys, ONE, *2 * ([*ONE, "--store", str(tmp_path / "s.jsonl")],))
    assert stored == [found, found] and [r["mu"] for r in found["runs"]] == [0.1, 0.2]


@pytest.mark.slow
def test_command_of_several_processes(capsys):
    one, several = told(capsys, ONE, ["--workers", "2"])
    assert several == one


def told(capsys, *options):
    """Figures of a sweep with each of these options."""
    return [json.loads(run(capsys, "slide", *SETTINGS, "--json", *more)[1]) for more in options]


def test_command_with_a_failing_run(capsys):
    code, out, err = run(
        capsys, "slide", *ONE, *"--solver pgs --tol 1e-300 --time 0.02 --on-fail raise --set mu=0.1".split()
    )
    assert code == 1 and out.splitlines()[0].split() == ["mu"] and "failed: {'mu': 0.1}: step" in err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["sleigh"], "scene must be one of"),
        (["slide", "--set", "mu=0.1,much"], "mu must be a number, got 'much'"),
        (["slide", "--set", "colour=red"], "parameter of scene slide must be one of mu, speed,"),
        (["slide", "--workers", "0"], "--workers must be at least 1"),
        (["slide", "--store", "/dev/null"], "it is no regular file"),
    ],
)
def test_bad_commands(capsys, arguments, words):
    code, out, err = run(capsys, *arguments)
    assert code == 2 and out == "" and words in err


def test_a_named_scene_comes_with_what_drives_it():
    """As `nsdyn run` has it: balls that nobody pushes do not roll."""
    setup = nd.scenes.setup("rolling", balls=2)
    alone = nd.simulate(setup.scene, 0.1, **setup.options(dt=0.01))
    (member,) = nd.sweep("rolling", {"balls": [2]}, 0.1, dt=0.01)
    np.testing.assert_array_equal(member.result.q, alone.q)
    assert np.abs(alone.v[-1]).max() > 0.01
    still = nd.simulate(setup.scene, 0.1, **setup.options(dt=0.01, external_force=None))
    assert np.abs(still.v[-1]).max() < 1e-8


@pytest.mark.parametrize("dts", [1e-2, "fine", ["fine", 1e-2], [1e-2, float("nan")], [1e-2, 1e-2]])
def test_a_refinement_needs_two_steps(dts):
    with pytest.raises(ValueError, match="dts must be at least two different positive numbers of seconds, got"):
        nd.refine("slide", dts, 0.04)
