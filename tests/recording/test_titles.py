"""Recordings know how they were made, and two beside each other are called by what differs."""

import contextlib
import io
import json

import h5py
import numpy as np
import pytest

import nsdyn as nd
from nsdyn.cli.command import main
from nsdyn.recording.trajectory import Trajectory
from nsdyn.view import titles, viewer

SLIDE = {"mu": 0.5, "speed": 2.0, "heading": 0.0, "size": 0.2, "mass": 1.0}


def parameters(trajectory):
    return json.loads(trajectory.meta["parameters"])


def slide(dt=0.01, solver=None, impact="dissipative", **settings):
    return nd.simulate(nd.scenes.load("slide")(**settings), 0.02, dt=dt, solver=solver, impact=impact)


def thrown(speed, mu=0.4, **rest):
    scene = nd.Scene(name="thrown")
    scene.add_halfspace("ground", material=nd.Material(mu=mu))
    scene.add_sphere("ball", 0.1, 1.0, position=(0, 0, 0.1), linear_velocity=(speed, 0, 0))
    return scene


def test_command_line(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = ["run", "slide", "--set", "mu=0.2", "--time", "0.01", "-o", "a b.h5"]
    with contextlib.redirect_stdout(io.StringIO()):
        assert main(words) == 0
    meta = Trajectory.load("a b.h5").meta
    assert json.loads(meta["parameters"]) == SLIDE | {"mu": 0.2}
    assert meta["command"] == "nsdyn run slide --set mu=0.2 --time 0.01 -o 'a b.h5'"
    assert meta["dt"] == 1e-3 and meta["solver"].startswith("Auto(") and meta["nsdyn_version"] == nd.__version__
    assert str(tmp_path) not in json.dumps(meta)
    assert slide().meta["command"] == ""  # what follows is no command


@pytest.mark.slow
def test_scenes_by_name_and_by_function():
    assert parameters(slide()) == SLIDE
    assert parameters(nd.simulate(nd.scenes.load("slide")(0.3), 0.01)) == SLIDE | {"mu": 0.3}
    assert nd.scenes.setup("rolling", balls=3).scene.parameters["balls"] == 3
    for executor in (None, 1):
        runs = nd.sweep("slide", {"mu": [0.1, 0.2]}, 0.01, executor=executor)
        assert [parameters(run.result) for run in runs] == [SLIDE | {"mu": mu} for mu in (0.1, 0.2)]
    runs = nd.sweep(thrown, {"speed": [np.float64(1.5)], "n": [np.arange(2)]}, 0.01)
    assert parameters(runs[0].result) == {"speed": 1.5, "mu": 0.4, "n": [0, 1]}
    own = thrown(1.0)
    assert parameters(nd.simulate(own, 0.01)) == {}
    own.parameters["speed"] = 1.0
    assert parameters(nd.simulate(own, 0.01)) == {"speed": 1.0}


def test_scene_file_of_ones_own(tmp_path):
    path = tmp_path / "own.py"
    path.write_text(
        "from nsdyn import Scene\nDURATION, DT = 0.1, 0.01\n"
        "def scene(mass: float = 2.0, kind: str = 'a') -> Scene:\n"
        "    out = Scene(name='own')\n    out.add_sphere('ball', 0.1, mass)\n    return out\n"
    )
    setup = nd.scenes.setup(str(path), kind="b")
    assert parameters(nd.simulate(setup.scene, 0.02, dt=0.01)) == {"mass": 2.0, "kind": "b"}
    assert nd.scenes.name_of(nd.scenes.load(str(path))) == str(path)


def test_any_value_has_a_text_that_is_the_same_again(tmp_path):
    class Thing:
        pass

    scene = thrown(1.0)
    scene.parameters = {
        "thing": Thing(),
        "function": thrown,
        "material": nd.Material(mu=0.25),
        "many": np.arange(50_000.0),
        "name": "μ \0 \udcff",
        "none": None,
        "nested": {"a": np.float32(0.5)},
    }
    path = tmp_path / "run.h5"
    meta = nd.simulate(scene, 0.01, record=path).meta
    scene.parameters["thing"] = Thing()
    assert meta["parameters"] == nd.simulate(scene, 0.01).meta["parameters"]
    kept = parameters(Trajectory.load(path))
    assert kept["many"][-1] == 49_999.0 and kept["name"] == "μ \0 \udcff" and kept["nested"] == {"a": 0.5}
    assert "0x" not in meta["parameters"] and kept["function"] == "thrown" and "mu=0.25" in kept["material"]


def test_equal_runs_are_equal():
    one, other = slide(mu=0.2), slide(mu=0.2)
    assert one.meta == other.meta
    pages = []
    for run in (one, other):
        columns = run.columns | {name: np.zeros_like(run.columns[name]) for name in ("wall_time", "solver/time")}
        pages.append(viewer.html(Trajectory(run.meta, run.scene, columns)))
    assert pages[0] == pages[1]


def test_parameters_that_are_not_known_and_damaged_ones(tmp_path):
    path = tmp_path / "run.h5"
    whole = nd.simulate(nd.scenes.load("slide")(), 0.02, dt=0.01, record=path)
    with h5py.File(path, "r+") as file:
        file["meta"].attrs.update(parameters="{}", command="")
    old = Trajectory.load(path)
    assert parameters(old) == {}
    assert titles.labels([old, slide(mu=0.2)]) == ["slide", "slide"]  # it is not known that they differ
    assert "slide | slide - nsdyn" in viewer.html(old, beside=whole)
    assert nd.simulate(nd.scenes.load("slide")(), 0.04, dt=0.01, resume=path).steps == 4
    for text, words in (("[1]", "a JSON object expected"), ("{", "/meta/parameters is no JSON")):
        with h5py.File(path, "r+") as file:
            file["meta"].attrs["parameters"] = text
        with pytest.raises(ValueError, match=words):
            Trajectory.load(path)


def test_a_run_goes_on_whatever_its_parameters_are_called(tmp_path):
    path = tmp_path / "run.h5"
    scene = thrown(1.0)
    nd.simulate(scene, 0.02, dt=0.01, record=path)
    scene.parameters["speed"] = 1.0
    assert nd.simulate(scene, 0.04, dt=0.01, resume=path).steps == 4


@pytest.mark.parametrize(
    ("one", "other", "title"),
    [
        ({}, {}, "slide | slide"),
        ({"mu": 0.2}, {}, "slide: mu=0.2 | mu=0.5"),
        ({"mu": 0.2, "speed": 1.0}, {}, "slide: mu=0.2, speed=1 | mu=0.5, speed=2"),
        ({"mu": 0.1 + 0.2}, {"mu": 0.3}, "slide: mu=0.30000000000000004 | mu=0.3"),
        ({"mu": 1 / 3}, {"mu": 2 / 3}, "slide: mu=0.333333 | mu=0.666667"),
        ({"dt": 0.005}, {}, "slide: dt=0.005 s | dt=0.01 s"),
        ({"mu": 0.2, "dt": 0.005}, {}, "slide: mu=0.2, dt=0.005 s | mu=0.5, dt=0.01 s"),
        ({"solver": "pgs"}, {"solver": "newton"}, "slide: solver=PGS | solver=Newton"),
        ({}, {"impact": "newton"}, "slide: impact=Dissipative | impact=Newton"),
        (
            {"solver": nd.solvers.by_name("pgs", 1e-6)},
            {"solver": nd.solvers.by_name("pgs", 1e-9)},
            "slide: tol=1e-06 | tol=1e-09",
        ),
    ],
)
def test_titles_tell_what_differs(one, other, title):
    shown = [slide(**one), slide(**other)]
    assert titles.document(shown) == title
    assert f"<title>{title} - nsdyn</title>" in viewer.html(shown[0], beside=shown[1])


def test_titles_of_two_scenes():
    other = nd.simulate(nd.scenes.load("bounce")(), 0.02, dt=0.005)
    assert titles.document([slide(), other]) == "slide | bounce"
    assert titles.document([other]) == "bounce" and titles.labels([other]) == ["bounce"]


def test_comparison_names_the_parameters():
    found = nd.compare(slide(mu=0.2), slide())
    assert found.options == {"mu": (0.2, 0.5)} and "mu: 0.2 and 0.5" in str(found)


def test_long_values_are_cut_and_strange_ones_are_shown():
    shown = [thrown(1.0), thrown(1.0)]
    for k, scene in enumerate(shown):
        scene.parameters = {"heights": np.arange(k, 50_000.0), "name": f"</title>\udcff{k}"}
    runs = [nd.simulate(scene, 0.01) for scene in shown]
    title = titles.document(runs)
    assert (
        title.startswith("thrown: heights=[0.0, 1.0, 2.0, ") and " | heights=[1.0, 2.0, " in title and len(title) < 250
    )
