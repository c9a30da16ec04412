"""Sweeps: every combination once, in order, with the same bits from every executor."""

import importlib.util
import json
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context

import numpy as np
import pytest

import nsdyn as nd
from nsdyn import cli
from nsdyn.study import sweep as ensemble


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


@pytest.mark.parametrize("kind", ["threads", "processes"])
def test_same_bits_from_every_executor(serial, kind):
    """A function of a named scene goes to other processes by its name; what `keep` makes of a run comes back."""
    pool = ThreadPoolExecutor(4) if kind == "threads" else ProcessPoolExecutor(2, get_context("spawn"))
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


def test_any_function_is_a_scene():
    (one,) = nd.sweep(lambda speed: nd.scenes.load("slide")(speed=speed), {"speed": [1.0]}, 0.05, dt=0.01)
    assert ensemble.figures(one.result)["displacement"] == pytest.approx(0.05 - 0.5 * 0.5 * 9.81 * 0.05**2)


def run(capsys, *arguments):
    code = cli.main(["sweep", *arguments])
    return code, *capsys.readouterr()


def test_command(capsys, tmp_path):
    settings = ["--set", "mu=0.1,0.2", "--set", "speed=1", "--time", "0.05", "--dt", "0.01"]
    code, out, _ = run(capsys, "slide", *settings, "--csv", str(tmp_path / "s.csv"))
    lines = out.splitlines()
    assert code == 0 and len(lines) == 3 and lines[0].split()[:3] == ["mu", "speed", "displacement"]
    assert lines[2].split()[:3] == ["0.2", "1", f"{0.05 - 0.1 * 9.81 * 0.05**2:.6g}"]
    assert len((tmp_path / "s.csv").read_text().splitlines()) == 3
    # Text and JSON, one process and several: the same figures.
    one, several = (json.loads(run(capsys, "slide", *settings, "--json", *w)[1]) for w in ([], ["--workers", "2"]))
    assert one == several and [r["mu"] for r in one["runs"]] == [0.1, 0.2]


def test_command_with_a_failing_run(capsys):
    code, out, err = run(
        capsys, "slide", "--solver", "pgs", "--tol", "1e-300", "--time", "0.02", "--on-fail", "raise", "--set", "mu=0.1"
    )
    assert code == 1 and out.splitlines()[0].split() == ["mu"] and "not converged: {'mu': 0.1}" in err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["sleigh"], "scene must be one of"),
        (["slide", "--set", "mu=0.1,much"], "mu must be a number, got 'much'"),
        (["slide", "--set", "colour=red"], "parameter of scene slide must be one of mu, speed,"),
        (["slide", "--workers", "0"], "--workers must be at least 1"),
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
