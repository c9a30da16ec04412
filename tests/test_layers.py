"""Imports go downwards only, from room to room and without circles inside; numba stays in the kernels."""

import ast
from graphlib import TopologicalSorter
from pathlib import Path

import nsdyn

ROOT = Path(nsdyn.__file__).parent
ROOMS = [
    "tools", "_kernels", "problem", "solvers", "scene", "collision", "dynamics", "recording", "stepping", "study",
    "compilation", "cli", "__main__",
]  # fmt: skip
"""From the ground up: each imports those before it."""

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
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
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


OURS = {name: {m for m in imports(path) if m in FILES} for name, path in FILES.items()}


def test_every_module_is_in_a_room():
    assert {room_of(name) for name in FILES} == set(ROOMS)


def test_imports_go_downwards():
    for name, others in OURS.items():
        for other in others:
            up = ROOMS.index(room_of(other)) > ROOMS.index(room_of(name))
            assert not up, f"{name} imports {other}"


def test_no_circles():
    TopologicalSorter(OURS).prepare()


def test_numba_only_in_kernels():
    users = {name for name, path in FILES.items() if any(m.split(".")[0] == "numba" for m in imports(path))}
    assert {room_of(name) for name in users} == {"_kernels"}


def test_mathematics_is_free_of_mechanics():
    for name, path in FILES.items():
        if room_of(name) in MATHEMATICS:
            assert not {m.split(".")[0] for m in imports(path)} & {"pinocchio", "coal", "meshcat"}, name
