"""The catalogue of hard and analytic cases: every test names its case, and none of those covered is missing."""

import ast
from pathlib import Path

COVERED = {*range(1, 43), *range(44, 51)}
"""Cases with tests, most of them in the files of this folder; `pytest -m case` runs them all."""


def test_all_cases_are_there():
    found = set()
    for path in sorted(Path(__file__).parents[1].rglob("test_*.py")):
        for node in ast.parse(path.read_text()).body:
            if isinstance(node, ast.FunctionDef) and node.name.startswith("test_"):
                marks = [m for m in node.decorator_list if ast.unparse(m).startswith("pytest.mark.case(")]
                assert marks or path.parent != Path(__file__).parent or path.samefile(__file__), (
                    f"{path.name}: {node.name} has no case marker"
                )
                found |= {int(mark.args[0].value) for mark in marks}
    assert sorted(COVERED - found) == []
