"""Imports go downwards only, the core needs no neighbour, names stand once; numba stays in the kernels."""

import ast
import os
import shutil
import subprocess
import sys
from collections import Counter
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

import nsdyn

ROOT = Path(nsdyn.__file__).parent
CORE = [
    "tools",
    "_kernels",
    "problem",
    "solvers",
    "scene",
    "collision",
    "dynamics",
    "recording",
    "stepping",
    "compilation",
]
NEIGHBOURS = ["literature", "audit", "view", "study", "bench", "cli"]
ROOMS = [*CORE, *NEIGHBOURS, "__main__"]
"""From the ground up: each imports those before it. The core needs none of its neighbours."""

ASKED = {("nsdyn.recording.trajectory", "nsdyn.view.viewer"), ("nsdyn.recording.trajectory", "nsdyn.view.embedding")}
"""What the core asks of its neighbours, where a user asks for it: `Trajectory.save_html`."""

MATHEMATICS = {"_kernels", "problem", "solvers"}
PUBLIC = {name: f"nsdyn.{home}" for home, names in nsdyn._HOME.items() for name in names}
PUBLIC |= {name: f"nsdyn.{home}" for name, home in nsdyn._MODULES.items()}


def name_of(path: Path) -> str:
    """Full name of a module."""
    parts = path.relative_to(ROOT.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


FILES = {
    name_of(path): path
    for path in ROOT.rglob("*.py")
    if "models" not in path.relative_to(ROOT).parts and path != ROOT / "__init__.py"
}


def room_of(module: str) -> str:
    return module.split(".")[1]


def imports(path: Path) -> set[str]:
    """Full names of the modules a file imports, in functions too, but for those that only annotations name."""
    tree = ast.parse(path.read_text())
    for node in ast.walk(tree):
        if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
            node.body = [ast.Pass()]
    out = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            out |= {a.name for a in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module == "nsdyn":
            out |= {PUBLIC.get(a.name, f"nsdyn.{a.name}") for a in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            full = {f"{node.module}.{a.name}" for a in node.names}
            out |= {name if name in FILES else node.module for name in full}
    return out


@pytest.fixture(scope="module")
def imported() -> dict[str, set[str]]:
    """What each file imports."""
    return {name: imports(path) for name, path in FILES.items()}


def test_every_module_is_in_a_room():
    assert {room_of(name) for name in FILES} == set(ROOMS)


def test_imports_go_downwards(imported):
    for name, others in imported.items():
        for other in (others & FILES.keys()) - {asked for asks, asked in ASKED if asks == name}:
            up = ROOMS.index(room_of(other)) > ROOMS.index(room_of(name))
            assert not up, f"{name} imports {other}"


@pytest.mark.slow
@pytest.mark.parametrize("rooms", [NEIGHBOURS, *([room] for room in NEIGHBOURS)], ids=str)
def test_the_core_does_without_its_neighbours(rooms, tmp_path):
    """The folders of all of them deleted, or of one, a scene is simulated, solved, recorded and read."""
    shutil.copytree(ROOT, tmp_path / "nsdyn", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copytree(ROOT.parent / "models", tmp_path / "models", ignore=shutil.ignore_patterns("__pycache__"))
    for room in rooms:
        shutil.rmtree(tmp_path / "nsdyn" / room)
    code = """
import nsdyn as nd
setup = nd.scenes.setup("slide")
nd.simulate(setup.scene, 0.02, 1e-2, record="run.h5")
assert nd.Trajectory.load("run.h5").steps == 2
assert {"auto", "newton"} <= set(nd.solvers.SOLVERS)
"""
    subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env=os.environ | {"PYTHONPATH": str(tmp_path)}, check=True
    )


def test_names_stand_in_one_room():
    """Kernels have the name of the module that calls them; else no two files are called the same."""
    names = Counter(
        path.stem for name, path in FILES.items() if "_kernels" not in name.split(".") and path.stem != "__init__"
    )
    assert not [name for name, count in names.items() if count > 1]


def test_no_circles(imported):
    ours = FILES.keys() - {asked for _, asked in ASKED}
    TopologicalSorter({name: others & ours for name, others in imported.items()}).prepare()


def test_numba_only_in_kernels(imported):
    users = {name for name, others in imported.items() if any(m.split(".")[0] == "numba" for m in others)}
    assert users and all("_kernels" in name.split(".") for name in users)


def test_mathematics_is_free_of_mechanics(imported):
    for name, others in imported.items():
        if room_of(name) in MATHEMATICS:
            assert not {m.split(".")[0] for m in others} & {"pinocchio", "coal", "meshcat"}, name
