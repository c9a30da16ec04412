"""Kernels run as plain Python, too, give the same bits there, and give back the memory that they take."""

import ast
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import nsdyn

ROOT = Path(nsdyn.__file__).parent
PATH = os.pathsep.join((str(ROOT.parent), str(Path(__file__).parent)))
SCRIPT = """
import json, sys, warnings
warnings.simplefilter("ignore")
seen = set()

def note(frame, event, argument):
    if event == "call" and "_kernels" in frame.f_code.co_filename:
        seen.add(frame.f_code.co_name)

import numpy as np
import nsdyn as nd
from everything import everything

if sys.argv[1:]:
    sys.setprofile(note)
    everything()
values = {}
for name in ("slide", "pile", "arm_pushes_box", "cards", "euler_disk", "bounce", "slider_crank"):
    setup = nd.scenes.setup(name)
    stepper = nd.Stepper(setup.scene, **setup.options(on_fail="ignore"))
    for _ in range(3):
        step = stepper.step()
    values[name] = np.concatenate((step.q, step.v)).tolist()
problem = nd.Stepper(nd.scenes.load("stack")(height=9), 5e-3).step().problem
alone = nd.FC3D(problem.W, problem.q, problem.mu)
small = nd.FC3D(np.eye(6) + 0.1, np.array([-1.0, 2.0, 0.0, -1.0, 0.1, 0.0]), np.full(2, 0.5))
for name in nd.solvers.SOLVERS:
    values[name] = nd.solve(small, name, 1e-6).u.tolist()
values["alone"] = nd.solve(alone, "auto", 1e-4, 1e-3 * np.ones_like(alone.q)).u.tolist()
print(json.dumps([values, sorted(seen)]))
"""

MEMORY = """
import gc, json, warnings
warnings.simplefilter("ignore")
import numpy as np
from numba.core.runtime import rtsys
from everything import everything
from nsdyn._kernels.compiled import kernel, no_alloc

@kernel
def made(n):
    return np.zeros(n)

@no_alloc
def lost(n):
    return made(n)[0]

def held(function):
    function()
    gc.collect()
    before = rtsys.get_allocation_stats()
    function()
    gc.collect()
    after = rtsys.get_allocation_stats()
    return after.mi_alloc - before.mi_alloc - (after.mi_free - before.mi_free)

print(json.dumps([held(everything), held(lambda: lost(3))]))
"""


def run(*arguments: str, **environment: str) -> tuple[dict[str, list[float]], list[str]]:
    """Results of the script in a process of its own, and the kernels that it called."""
    variables = os.environ | {"PYTHONPATH": PATH} | environment
    command = [sys.executable, "-c", SCRIPT, *arguments]
    return json.loads(subprocess.run(command, capture_output=True, text=True, check=True, env=variables).stdout)


def kernels() -> list[ast.FunctionDef]:
    """All kernels."""
    return [
        node
        for path in ROOT.rglob("*.py")
        if "_kernels" in path.parts
        for node in ast.parse(path.read_text()).body
        if isinstance(node, ast.FunctionDef)
        and any(ast.unparse(d).startswith(("kernel", "no_alloc")) for d in node.decorator_list)
    ]


def test_kernels_do_nothing_that_python_rounds_otherwise():
    """Powers of whole numbers, which are products there, lengths by `math`, and sums that are fused or reordered."""
    for node in kernels():
        for part in ast.walk(node):
            power = isinstance(part, ast.BinOp) and isinstance(part.op, ast.Pow)
            assert not (power and isinstance(part.right, ast.Constant)), (node.name, ast.unparse(part))
        assert not {"hypot", "fastmath"} & set(re.findall(r"(?<!np\.)\b\w+", ast.unparse(node))), node.name


@pytest.mark.slow  # plain Python takes its time
def test_plain_python_gives_the_same_bits():
    plain, called = run("all", NUMBA_DISABLE_JIT="1")
    compiled, _ = run()
    assert {node.name for node in kernels()} - set(called) == set()
    for name, values in compiled.items():
        assert plain[name] == values, name


@pytest.mark.slow  # all kernels in a process of its own, twice
def test_kernels_keep_no_memory(tmp_path):
    """Those that do not count references must call none that returns an array of its own: what does is found here."""
    variables = os.environ | {"PYTHONPATH": PATH, "NUMBA_NRT_STATS": "1"}
    path = tmp_path / "memory.py"
    path.write_text(MEMORY)
    command = [sys.executable, str(path)]
    output = subprocess.run(command, capture_output=True, text=True, check=True, env=variables).stdout
    kept, lost = json.loads(output)
    assert lost == 1
    assert kept == 0
