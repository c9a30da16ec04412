"""The benchmarks of the guide run, on the smallest scenes, and print what they promise."""

import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

from nsdyn.view import browser

ROOT = Path(__file__).resolve().parent.parent.parent
BENCH = ROOT / "demos" / "bench"
SCRIPTS = {
    "step_time.py": (["--scene", "stack", "--steps", "5"], r"nsdyn, tol 1e-06: +\d+ us"),
    "drop.py": (["--spheres", "8", "--time", "0.1"], r"nsdyn +mean +[\d.]+ ms.* 0 of 20 steps missed"),
    "collision.py": (["--boxes", "20"], r"18 pairs that touch, 72 contacts(.*\n)+nsdyn: batches"),
    "scaling.py": (["--only", "boxes", "2"], r'{"time": [\d.e-]+, "memory": [\d.]+}'),
    "at_rest.py": (["slide", "--rounds", "1"], r"slide +[\d.]+"),
    "portfolio.py": (["--steps", "2", "--set", "warm_steps=4"], r"mean [\d.]+ ms"),
    "regimes.py": (["{folder}", "--solver", "auto", "--bodies", "12"], r"collision, 1e-08\nsolver .*\nauto +4/4 "),
    "truth.py": (["slow_ball", "--quick"], r"slow_ball +speed +[\d.e+-]+ +1e-09"),
    "fuzz.py": (["urdf", "--count", "20"], r"urdf +20 cases.*\n0 failures"),
    "anything.py": (["--count", "3", "--steps", "5"], r"3 scenes: .*\nworst figures: "),
    "audits.py": (["--begin", "3", "--count", "2"], r"^ +\d+  passed"),
    "kills.py": (["--count", "1", "--scene", "rolling"], r"\d+ kills in \d+ runs, 0 failures"),
    "long.py": (["ball", "--time", "0.5"], r"ball t = +0\.5 s: .* 0 missed"),
    "sweep.py": (
        ["--runs", "40", "--time", "0.1", "--rounds", "1"],
        r"same bits: True\n.* 0 of 40 lost, same bits: True",
    ),
    "page.py": (
        ["slide", "--time", "0.1", "--size", "400x300", "--frames", "15"],
        r"slide: [\d.]+ MB, made in [\d.]+ s\nopens in [\d.]+ s\nscrubs at \d+ pictures a second",
    ),
    "landing.py": (["--links", "3", "--time", "0.3"], r"nsdyn +[\d.]+ +[\d.]+ +[\d.]+  0 steps above the tolerance"),
    "quadruped.py": (["--time", "0.05", "--robots", "1"], r"nsdyn +0.005 +1 +\d+"),
}


LONG = "at_rest.py", "audits.py", "fuzz.py", "kills.py", "page.py", "regimes.py", "sweep.py"
OWN = "at_rest.py", "fuzz.py", "kills.py", "sweep.py"
"""What starts, forks and kills processes, in a process of its own."""


def printed(script, arguments, monkeypatch, capsys):
    """What a script prints when it is run, in this process, which has the kernels, if it may be."""
    if script in OWN:
        command = [sys.executable, str(BENCH / script), *arguments]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout
    monkeypatch.setattr(sys, "argv", [script, *arguments])
    try:
        runpy.run_path(str(BENCH / script), run_name="__main__")
    except SystemExit as end:
        assert not end.code, capsys.readouterr()
    return capsys.readouterr().out


@pytest.mark.parametrize("script", [pytest.param(s, marks=[pytest.mark.slow] if s in LONG else []) for s in SCRIPTS])
def test_script_runs(script, tmp_path, monkeypatch, capsys):
    if script == "sweep.py":
        pytest.importorskip("distributed", reason="dask is not installed (extra `cluster`)")
    if script == "page.py" and browser.chromium() is None:
        pytest.skip("no Chromium on the PATH")
    arguments, expected = SCRIPTS[script]
    arguments = [argument.format(folder=tmp_path) for argument in arguments]
    out = printed(script, arguments, monkeypatch, capsys)
    assert re.search(expected, out), out


@pytest.mark.parametrize(
    "scene",
    [
        "--begin 7132",
        "--bad --begin 85 --seed 3",
        *(
            pytest.param(scene, marks=pytest.mark.slow)
            for scene in (
                "--begin 1109 --seed 2",
                "--begin 182 --seed 20261125",
                "--begin 3229 --seed 1",
                "--begin 9438 --seed 1",
                "--bad --begin 679 --seed 3",
                "--bad --begin 200 --seed 4",
                "--begin 34 --seed 77",
            )
        ),
    ],
)
def test_random_scenes_in_which_something_was_found(scene, monkeypatch, capsys):
    """Turned by projections and rolling resistance, impulses that are round-off, belts, needles, grains of 1e-5 m."""
    out = printed("anything.py", ["--count", "1", *scene.split()], monkeypatch, capsys)
    assert "1 scenes: {'passed': 1}" in out, out


def test_every_script_is_in_the_guide():
    text = "".join(page.read_text() for page in (ROOT / "demos" / "guide").glob("*.md"))
    for script in BENCH.glob("*.py"):
        assert script.name in text
        assert script.name in SCRIPTS
