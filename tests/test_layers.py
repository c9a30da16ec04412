"""Imports go downwards only, numba stays in the kernels, the mathematics knows no mechanics."""

import ast
from pathlib import Path

import nsdyn

ROOT = Path(nsdyn.__file__).parent
ORDER = [
    ["workers", "_kernels", "naming", "files", "noise", "unfinished"],
    ["cones"], ["problem"], ["formulations"], ["solvers", "fclib"],
    ["checks"], ["materials", "shapes", "motions", "control"], ["exclusions"], ["articulations"],
    ["robot_files"], ["scene"],
    ["contacts", "distances", "scenes"], ["detector", "settings"], ["loops", "surfaces"], ["trees"], ["joints"],
    ["dynamics"],
    ["overlap", "gauss", "impacts", "energy", "projection", "encounter", "profile", "_peers"],
    ["recording"], ["tables"], ["instant", "trajectory"], ["recorder"], ["balance", "collisions", "sight"], ["move"],
    ["arrows"], ["audit", "viewer", "stepper"],
    ["acceleration", "ensemble", "bench", "compilation"], ["cli"], ["__main__"],
]  # fmt: skip
LEVEL = {name: k for k, names in enumerate(ORDER) for name in names}
MATHEMATICS = {"_kernels", "cones", "problem", "formulations", "solvers", "fclib", "gauss"}


def imports(path: Path) -> set[str]:
    """Full names of the modules a file imports when it is loaded."""
    out = set()
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.Import):
            out |= {a.name for a in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module == "nsdyn":
            out |= {f"nsdyn.{a.name}" for a in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            out.add(node.module)
    return out


def modules() -> list[tuple[str, Path]]:
    files = [p for p in ROOT.rglob("*.py") if "models" not in p.relative_to(ROOT).parts]
    return [(p.relative_to(ROOT).with_suffix("").parts[0], p) for p in files if p != ROOT / "__init__.py"]


def test_every_module_has_a_layer():
    assert {name for name, _ in modules()} == set(LEVEL)


def test_imports_go_downwards():
    for name, path in modules():
        for module in imports(path):
            if module.startswith("nsdyn."):
                other = module.split(".")[1]
                assert other == name or LEVEL[other] < LEVEL[name], f"{path.name} imports {module}"


def test_numba_only_in_kernels():
    users = {name for name, path in modules() if any(m.split(".")[0] == "numba" for m in imports(path))}
    assert users == {"_kernels"}


def test_mathematics_is_free_of_mechanics():
    for name, path in modules():
        if name in MATHEMATICS:
            assert not {m.split(".")[0] for m in imports(path)} & {"pinocchio", "coal", "meshcat"}, path.name
