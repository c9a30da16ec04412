"""The first use on a machine compiles and says so; nothing is compiled twice, and nothing stale is used."""

import os
import pty
import shutil
import subprocess
import sys
import termios
import time
from contextlib import suppress
from pathlib import Path

import numba
import numpy as np
import pytest

import nsdyn
from nsdyn._kernels import compiled, sorting
from nsdyn._kernels.compiled import kernel
from nsdyn._kernels.solvers import start

HERE = Path(nsdyn.__file__).parent
COMMAND = """
from nsdyn.literature._kernels import variational as reference
from nsdyn._kernels.problem import cones
print(cones.project(2.0, 0.3, 0.4, 0.5), sum(cones.project.stats.cache_misses.values()))
"""
BOX = """
import nsdyn, coal, numpy
nsdyn.Scene()
below = coal.Transform3s(numpy.eye(3), numpy.array([0.0, 0.0, -3.0]))
asked = coal.Capsule(0.5, 1.0), below, coal.Box(2.0, 2.0, 2.0), coal.Transform3s()
print(coal.distance(*asked, coal.DistanceRequest(), coal.DistanceResult()))
"""
AFTER_ALL = """
import warnings
from nsdyn import compilation
from nsdyn._kernels.compiled import Kernel
from nsdyn.scene import named
from nsdyn.stepping.stepper import Stepper

warnings.simplefilter("ignore")
calls, load = [], Kernel.load_overload
Kernel.load_overload = lambda *kernel: calls.append(str(kernel[0])) or load(*kernel)
compilation.run(compilation.STEPS[-1])
calls.clear()
for name in named.names():
    setup = named.setup(name)
    stepper = Stepper(setup.scene, **setup.options(on_fail="ignore"))
    for _ in range(300):
        stepper.step()
print(calls)
"""
CALLER = """
from nsdyn._kernels import callee
from nsdyn._kernels.compiled import kernel

@kernel
def twice(x):
    return 2.0 * callee.given(x)

print(twice(1.0), sum(twice.stats.cache_misses.values()))
"""
CALLEE = """
from nsdyn._kernels.compiled import kernel

@kernel
def given(x):
    return x
"""

OTHER_SCENES = (
    (HERE / "compilation.py").read_text()
    + """
from nsdyn._kernels import callee
SCENES = ()
callee.given(1.0)
callee.given(1)
"""
)
MEANWHILE = """
import time
from nsdyn._kernels.callee import given
for _ in range({}):
    print(given(1.0), len(given.signatures))
    if given.signatures:
        break
    time.sleep(0.1)
"""


def python(*command: str, **environment: str) -> subprocess.CompletedProcess:
    # Safe: not the package of the current folder
    variables = os.environ | {"PYTHONPATH": str(HERE.parent), "PYTHONSAFEPATH": "1"} | environment
    return subprocess.run([sys.executable, *command], capture_output=True, text=True, check=True, env=variables)


IMPATIENT = "from nsdyn._kernels import compiled; compiled.PATIENCE = -1.0\n"


@pytest.mark.slow
def test_compiling_is_told_to_who_waits(tmp_path):
    """Not before two seconds, once in a process, and not where all is in the cache."""
    for k, told in enumerate(("", "kernels that are new to this machine are compiled: a slow minute or two\n", "")):
        done = python("-c", (IMPATIENT if k else "") + COMMAND, NSDYN_CACHE_DIR=str(tmp_path))
        assert (done.stdout, done.stderr) == (f"(2.0, 0.3, 0.4) {int(k < 2)}\n", told)
        for path in tmp_path.glob("*.nbc") if k == 0 else ():
            path.unlink()


SOLVE = """
import time
clock = [0.0]
def read():
    clock[0] += 1e-6
    return clock[0]
import numpy, nsdyn
from nsdyn._kernels.compiled import Kernel
loaded = Kernel.load_overload
def load(*arguments):
    clock[0] += 0.3
    return loaded(*arguments)
problem = nsdyn.FC3D(numpy.eye(6) + 0.1, [-1.0, 2.0, 0.0, -1.0, 0.1, 0.0], [0.5, 0.5])
time.perf_counter, Kernel.load_overload = read, load
for _ in range(3):
    print(nsdyn.solve(problem).time, clock[0])
"""


@pytest.mark.slow
def test_the_time_of_solving_is_without_loading():
    """On a clock on which loading a kernel takes 0.3 s, and reading it 1 µs: the first time is as any other."""
    times, clock = np.array([line.split() for line in python("-c", SOLVE).stdout.splitlines()], float).T
    assert clock[0] > 0.3 and clock[-1] < clock[0] + 0.3, "the first one loads"
    assert 0.0 < times.min() and times.max() < 0.3


def test_functions_of_users_from_nowhere_compile():
    """One that was made by exec has no module."""
    names: dict = {}
    exec("def f(x): return x + 1", names)
    assert numba.njit(names["f"])(1) == 2


@pytest.fixture
def package(tmp_path):
    """Copy of the package in another place, as another environment has one."""
    shutil.copytree(HERE, tmp_path / "a" / "nsdyn", ignore=shutil.ignore_patterns("__pycache__"))
    return tmp_path / "a"


@pytest.mark.slow
def test_another_environment_compiles_nothing(package, tmp_path):
    for path in (package, shutil.copytree(package, tmp_path / "b")):
        done = python("-c", COMMAND, PYTHONPATH=str(path), NSDYN_CACHE_DIR=str(tmp_path / "cache"))
    assert done.stdout.endswith(" 0\n")


@pytest.mark.slow
def test_an_edited_callee_is_seen_and_nothing_else_compiled(package, tmp_path):
    kernels, environment = package / "nsdyn" / "_kernels", {"PYTHONPATH": str(package)}
    environment["NSDYN_CACHE_DIR"] = str(tmp_path / "cache")
    (kernels / "caller.py").write_text(CALLER)
    (kernels / "callee.py").write_text(CALLEE)
    both = "import nsdyn._kernels.caller" + COMMAND
    assert python("-c", "import nsdyn._kernels.caller", **environment).stdout == "2.0 1\n"
    (kernels / "callee.py").write_text(CALLEE.replace("return x", "return x + 1.0"))
    assert python("-c", both, **environment).stdout == "4.0 1\n(2.0, 0.3, 0.4) 1\n"
    (kernels / "callee.py").write_text(CALLEE)
    assert python("-c", both, **environment).stdout == "2.0 0\n(2.0, 0.3, 0.4) 0\n"


@pytest.mark.slow
def test_without_a_cache_it_works(tmp_path):
    (tmp_path / "file").touch()
    for _ in range(2):
        assert python("-c", COMMAND, NSDYN_CACHE_DIR=str(tmp_path / "file" / "below")).stdout == "(2.0, 0.3, 0.4) 1\n"


def test_sorting(rng):
    for keys in (rng.integers(0, 20, 57), rng.normal(size=8), np.empty(0)):
        order = sorting.order(keys)
        assert (order == np.argsort(keys, kind="stable")).all()
        assert all(sorting.place_of(keys[order], key) == np.searchsorted(keys[order], key) for key in keys)


@pytest.mark.slow
def test_a_terminal_gets_a_bar(package, tmp_path):
    """Of two kernels of the types int and float, which this process compiles, and the one beside it."""
    (package / "nsdyn" / "_kernels" / "callee.py").write_text(CALLEE)
    (package / "nsdyn" / "compilation.py").write_text(OTHER_SCENES)
    main, end = pty.openpty()
    termios.tcsetwinsize(end, (24, 80))
    environment = {"PYTHONPATH": str(package), "PYTHONSAFEPATH": "1", "NSDYN_CACHE_DIR": str(tmp_path / "cache")}
    with subprocess.Popen(
        [sys.executable, "-c", "from nsdyn.compilation import compile_all; compile_all()"],
        stdout=subprocess.DEVNULL,
        stderr=end,
        env=os.environ | environment | {"NSDYN_COMPILE_PROCESSES": ""},
    ):
        os.close(end)
        shown = b""
        with suppress(OSError):  # the other end is closed
            while part := os.read(main, 4096):
                shown += part
    os.close(main)
    assert b"| 2/2 [" in shown and b"kernel" in shown
    assert len(list((tmp_path / "cache").glob("callee.*.nbc"))) == 2
    assert not list((tmp_path / "cache").glob("*.ask"))


@pytest.mark.slow
def test_what_is_compiled_ahead_is_all_that_named_scenes_call():
    assert python("-c", AFTER_ALL, NSDYN_COMPILE_PROCESSES="1").stdout == "[]\n"


@pytest.mark.slow
def test_machine_code_is_made_of_what_python_calls(package, tmp_path):
    """Of a callee with its callers only, until Python calls it; the second time all is from the cache."""
    kernels, environment = package / "nsdyn" / "_kernels", {"PYTHONPATH": str(package)}
    environment["NSDYN_CACHE_DIR"] = str(tmp_path / "cache")
    (kernels / "caller.py").write_text(CALLER)
    (kernels / "callee.py").write_text(CALLEE)
    command = "from nsdyn._kernels.caller import callee; f = callee.given; print(f.signatures, f(1.0), f.signatures)"
    for misses in (1, 0):
        done = python("-c", command, **environment)
        assert done.stdout == f"2.0 {misses}\n[] 1.0 [(float64,)]\n"


@pytest.mark.slow
def test_nothing_waits_for_the_compiler(package, tmp_path):
    """Another process compiles, which goes on when the run ends; one that goes on loads it."""
    (package / "nsdyn" / "_kernels" / "callee.py").write_text(CALLEE)
    cache, environment = tmp_path / "cache", {"PYTHONPATH": str(package), "NSDYN_COMPILE_PROCESSES": ""}
    environment["NSDYN_CACHE_DIR"] = str(cache)
    assert python("-c", MEANWHILE.format(1), **environment).stdout == "1.0 0\n"
    deadline = time.monotonic() + 300.0
    while not list(cache.glob("callee.*.nbc")) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert python("-c", MEANWHILE.format(1), **environment).stdout == "1.0 1\n"
    environment["NSDYN_CACHE_DIR"] = str(tmp_path / "other")
    first, *between, last = python("-c", MEANWHILE.format(3000), **environment).stdout.splitlines()
    assert {first, *between} == {"1.0 0"} and last == "1.0 1"
    environment |= {"NSDYN_CACHE_DIR": str(tmp_path / "third"), "NSDYN_COMPILE_PROCESSES": "1"}
    assert python("-c", MEANWHILE.format(1), **environment).stdout == "1.0 1\n", "it compiles itself"


@kernel
def _counted(x):
    return x.size


@kernel(rounds=compiled.LARGE)
def _much(x):
    return x.size


def test_what_takes_long_is_waited_for(monkeypatch):
    """Large arrays, many rounds, and where times are told; the request for a process is a list here."""
    asked = []
    monkeypatch.setattr(compiled, "ask", lambda *request: asked.append(request) or True)
    monkeypatch.setattr(compiled.Kernel, "file", lambda *_: Path(os.devnull, "none"))
    for of, x in (
        (_counted, np.ones(3)),
        (_much, np.ones(1, int)),
        (_much, np.ones(3)),
        (_counted, np.empty(2**21, int)),
    ):
        assert of(x) == x.size
    assert [request[0] for request in asked] == [_counted, _much]
    assert compiled.is_ready(_counted, np.ones(3)) and not compiled.is_ready(_counted, np.empty(2**21))
    assert asked.pop()[0] is _counted
    compiled.waiting.append(asked)
    try:
        assert _counted(np.ones(3)) == 3
    finally:
        compiled.waiting.pop()
    assert len(asked) == 2 and len(_counted.signatures) == 2 and len(_much.signatures) == 1


def test_the_interpreter_returns_what_compiled_kernels_do(rng):
    """Numbers of Python, and calls of other kernels, of those of other modules, too, as of Python."""
    r, u, W = np.empty(3), np.empty(3), np.eye(3) + 0.1
    given = W, np.array([-1.0, 2.0, 0.1]), np.array([0.5])
    start.closed_form(*given, r, u)
    as_python = np.empty(3), np.empty(3)
    start.closed_form._as_python(*given, *as_python)
    assert (as_python[0] == r).all() and (as_python[1] == u).all()
    for of, of_them in (
        (sorting.place_of, (np.arange(3.0), 1.5)),
        (start.cones.project, (2.0, *rng.normal(size=2), 0.5)),
    ):
        out, twin = of(*of_them), of._as_python(*of_them)
        assert out == twin and type(out) is type(twin)
    assert [type(x) for x in twin] == [type(x) for x in out] == [float] * 3


@kernel
def _product_and_sum(a, b, c):
    """a b + c with both rounded."""
    return a * b + c


@kernel(fastmath={"contract"})
def _contracts(a, b, c):
    """The same by a kernel that may round once, and compiles the other first."""
    return _product_and_sum(a, b, c)


def test_a_kernel_rounds_as_it_says_whoever_calls_it_first():
    """(1 + 2⁻³⁰) (1 - 2⁻³⁰) - 1 is 0 with the product rounded, -2⁻⁶⁰ without."""
    given = 1.0 + 2.0**-30, 1.0 - 2.0**-30, -1.0
    assert _contracts(*given) == 0.0
    assert _product_and_sum(*given) == 0.0


@pytest.mark.slow
def test_what_coal_is_asked_first_does_not_make_boxes_wider():
    """It decides for all boxes of a process; asked along the axes Coal would say 1 - 1e-10 here."""
    assert abs(float(python("-c", BOX).stdout) - 1.0) < 1e-14
