"""Shared fixtures: seeded randomness, the solvers, a step of a small mixed scene."""

import importlib.metadata
import os
import shutil
from pathlib import Path

import fuzz
import numpy as np
import pages
import pytest

import nsdyn as nd
from nsdyn import cli
from nsdyn.view import browser

# What is tested is machine code, not the interpreter until there is some.
os.environ.setdefault("NSDYN_COMPILE_PROCESSES", "1")

SOLVERS = {name: nd.solvers.by_name(name, 1e-8) for name in nd.solvers.SOLVERS}


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20261121)


@pytest.fixture(params=sorted(SOLVERS))
def solver(request: pytest.FixtureRequest) -> nd.solvers.Solver:
    return SOLVERS[request.param]


@pytest.fixture(scope="session")
def window():
    """A headless browser: one of all tests of a process, each of which opens its own page."""
    with browser.browsing() as page:
        yield page


@pytest.fixture(scope="session")
def opened(window, tmp_path_factory):
    """Function that opens the page of a recording, at its beginning and paused, in a window of a size."""
    return pages.Opener(window, tmp_path_factory.mktemp("pages"))


@pytest.fixture
def run(capsys, tmp_path, monkeypatch):
    """Run the command in an empty folder; (exit code, stdout, stderr)."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments):
        try:
            code = cli.main([str(a) for a in arguments])
        except SystemExit as exit_:  # argparse ends --help and wrong usage so
            code = exit_.code
        out, err = capsys.readouterr()
        return code, out, err

    return run


def drift(trajectory: nd.Trajectory) -> float:
    """Largest displacement in m of any free body from its start."""
    free = trajectory.q.shape[1] // 7
    x = trajectory.q[:, : 7 * free].reshape(len(trajectory.t), free, 7)[..., :3]
    return float(np.abs(x - x[0]).max())


def penetration(trajectory: nd.Trajectory) -> float:
    """Deepest gap in m over all contacts of all steps."""
    return float(-min(trajectory.contacts(k).gap.min(initial=0.0) for k in range(1, len(trajectory.t))))


INERTIAL = '<inertial><mass value="1"/><inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial>'

DATA = Path(__file__).parent / "data"


@pytest.fixture
def share():
    """The folder of packages with the robots of example-robot-data."""
    try:
        package = importlib.metadata.distribution("example-robot-data")
    except importlib.metadata.PackageNotFoundError:
        pytest.skip("the extra 'robots' is not installed")
    return Path(str(package.locate_file("cmeel.prefix/share")))


@pytest.fixture
def robot(tmp_path):
    """A robot with a bit of everything, and the folder that holds its package."""
    (tmp_path / "share" / "thing").mkdir(parents=True)
    (tmp_path / "share" / "thing" / "box.stl").write_bytes(fuzz.binary_stl())
    path = Path(shutil.copy(DATA / "robot.urdf", tmp_path))
    return path, [tmp_path / "share"]
