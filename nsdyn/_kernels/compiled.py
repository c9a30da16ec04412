"""The decorator of all kernels, and the files in which they are kept: nothing waits for the compiler.

A kernel that has no machine code yet is run by the interpreter, with the same bits, while another process compiles it.
Only what takes long there is waited for.

numba makes machine code of every function that it compiles, with entries from Python and from C, and optimises it with
all that it calls, again for each caller: half as long again as here, where only what Python calls becomes machine code,
with all below it. Of a kernel that kernels call there is LLVM's code. Both are files in a folder of the user, named by
all that is in them: the text of the kernel's module and of those of ours which that imports, types of arguments,
processor and versions. So nothing is ever out of date, and all environments share them.
"""

from __future__ import annotations

import fcntl
import gc
import hashlib
import logging
import os
import pickle
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from contextvars import ContextVar
from functools import cache, partial
from importlib import import_module
from pathlib import Path
from types import FunctionType, ModuleType, SimpleNamespace
from typing import Any

import llvmlite.binding as llvm
import numba
import numpy as np
from numba.core import config, typing
from numba.core.compiler import CompileResult, Flags, compile_extra
from numba.core.registry import CPUDispatcher
from numba.core.serialize import dumps
from numba.core.types import unliteral

FOLDER, PROCESSES = "NSDYN_CACHE_DIR", "NSDYN_COMPILE_PROCESSES"
"""Environment variables: the folder of the files, and 1 if no process compiles but the one that calls, which waits."""

KEEP, LINGER, PATIENCE = 60 * 86400.0, 5.0, 2.0
"""s after its last use that a file is kept, in which a process that compiles looks for more to do, and of loading and
compiling about which nothing is said."""

LARGE = 100_000
"""Numbers gone through in a call, a tenth of a second of the interpreter, above which machine code is waited for."""

VERSIONS = sys.implementation.cache_tag, numba.__version__, np.__version__

_IMPORT = re.compile(r"^(?:from|import) +(nsdyn[\w.]*)(?: +import +(\([^)]*\)|.*))?", re.MULTILINE)

_loading = ContextVar("seconds", default=0.0)
loading = _loading.get  # how long this thread has waited for kernels to be loaded or compiled, s
waiting: list[object] = []  # who waits for kernels, as what tells times: all threads do then
_processes: list[subprocess.Popen[bytes]] = []  # that compile; else Python would tell that they still run


def clock() -> float:
    """Time in s since some moment, without `loading`."""
    return time.perf_counter() - loading()


@cache
def announce() -> None:
    """Tell, once in a process, that kernels are compiled."""
    logging.getLogger("nsdyn").warning("kernels that are new to this machine are compiled: a slow minute or two")


@cache
def folder() -> Path | None:
    """Folder of the files, made if there is none; None if it cannot be written."""
    place = Path(os.environ.get(FOLDER) or Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache", "nsdyn"))
    try:
        place = place.expanduser().absolute()
        place.mkdir(mode=0o700, parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=place).close()
    except (OSError, RuntimeError):
        return None
    for entry in os.scandir(place):
        with suppress(OSError):
            if time.time() - entry.stat().st_mtime > KEEP:
                os.unlink(entry)
    return place


@cache
def content(module: str) -> str:
    """Hash of the text of a module and of the contents of those of ours that it imports."""
    text, names = Path(sys.modules[module].__file__ or "").read_text(), set()
    for package, parts in _IMPORT.findall(text):
        names |= {".".join((package, *part.split()[:1])) for part in ("", *parts.strip("()").split(","))}
    return hashlib.sha256("".join((text, *map(content, sorted(names & sys.modules.keys())))).encode()).hexdigest()


@cache
def plain(module: str) -> dict[str, Any]:
    """What a module of kernels has, with the functions that they are in their places."""
    names = dict(vars(sys.modules[module]))
    for name, value in list(names.items()):
        if isinstance(value, Kernel):
            own = names if value.__module__ == module else plain(value.__module__)
            names[name] = FunctionType(value.py_func.__code__, own)
        elif isinstance(value, ModuleType) and value.__name__.startswith("nsdyn."):
            names[name] = SimpleNamespace(**plain(value.__name__))
    return names


def size(x: Any) -> int:
    """How many numbers a kernel is given."""
    return sum(map(size, x)) if isinstance(x, tuple) else getattr(x, "size", 1)


def scalars(x: Any) -> Any:
    """What a kernel returns, with Python's numbers for those of NumPy, as of a compiled one."""
    return tuple(map(scalars, x)) if type(x) is tuple else x.item() if isinstance(x, np.generic) else x


class Kernel(CPUDispatcher):
    """Compiled function, compiled for variables where it is given constants."""

    cache_path = None  # of what `stats` tells of a cache
    rounds = 1

    def __init__(self, function: Callable[..., Any], *others: Any, **options: Any) -> None:
        super().__init__(function, *others, **options)
        # The text is read now, since it may be edited before the first call
        self._cache, self._callees, self._content = self, {}, content(function.__module__)

    @cache  # noqa: B019 (kernels stay)
    def file(self, types: Any, form: str = "machine code") -> Path:
        """File of this kernel for these types; where there is no folder, one that cannot be read or written."""
        self.targetctx.refresh()
        made_of = form, self._content, str(types), self.targetctx.codegen().magic_tuple(), VERSIONS, config.BOUNDSCHECK
        name = f"{self.py_func.__module__.rpartition('.')[2]}.{self.py_func.__qualname__}"
        key = hashlib.sha256(repr((name, *made_of)).encode()).hexdigest()
        return Path(folder() or os.devnull, f"{name}-{key[:32]}.nbc")

    def load_overload(self, types: Any, context: Any) -> CompileResult | None:
        """What numba asks of a cache."""
        if kept := load(self.file(types)):
            return CompileResult._rebuild(context, *kept)
        if loading() > PATIENCE:
            announce()
        return None

    def save_overload(self, types: Any, result: CompileResult) -> None:
        """What numba tells a cache."""
        save(self.file(types), result._reduce())

    def callee(self, types: Any) -> tuple[Any, object, Any]:
        """(signature, entry, environment) of what kernels call: LLVM's code."""
        if types not in self._callees:
            if not (kept := load(self.file(types, "LLVM code"))):
                kept = self._lower(types)
                save(self.file(types, "LLVM code"), kept)
            name, code, description, environment, signature, initialisations = kept
            for initialise in initialisations:
                initialise()
            library = self.targetctx.codegen().create_library(name)
            library._final_module, library._finalized = llvm.parse_bitcode(code), True
            # By its entry, an address, numba finds how a function is called: any object that is no other's will do
            self._callees[types] = out = signature, object(), environment
            self.targetctx.insert_user_function(out[1], description, [library])
        return self._callees[types]

    def _lower(self, types: Any) -> tuple[Any, ...]:
        """LLVM's code for these types, simplified function by function: its callers are optimised with it."""
        flags = Flags()
        self.targetdescr.options.parse_as_flags(flags, self.targetoptions)
        flags.no_compile = flags.no_cpython_wrapper = flags.no_cfunc_wrapper = True
        result = compile_extra(self.typingctx, self.targetctx, self.py_func, types, None, flags, {})
        library, description = result.library, result.fndesc
        library._optimize_final_module = library._finalize_final_module = lambda: None
        library.finalize()
        description.typemap = description.calltypes = None  # as numba does: of no use, and not to be pickled
        code = library._final_module.as_bitcode()
        return library.name, code, description, result.environment, result.signature, result.reload_init

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """Meaning of a call in another kernel; numba would compile f(0) and f(i) both."""
        signature, folded = self._compiler.fold_argument_types(tuple(map(unliteral, args)), kws)
        name = self.py_func.__name__
        found = typing.make_concrete_template(name, key=name, signatures=[self.callee(tuple(folded))[0]])
        return found, signature, folded, {}

    def get_overload(self, types: Any) -> Any:
        """What numba knows the function by that another kernel calls."""
        return self.callee(tuple(types))[1]

    def is_quick(self, args: Any) -> bool:
        """Whether the interpreter is quick enough."""
        return not waiting and self.rounds * size(args) <= LARGE

    def is_missing(self, args: Any) -> bool:
        """Whether there is no machine code yet, and another process makes it."""
        types = tuple(map(self.typeof_pyval, args))
        return not self.file(types).exists() and ask(self, types)

    def _compile_for_args(self, *args: Any) -> Any:
        """What to call instead, at a call from Python with new types."""
        if self.is_quick(args) and self.is_missing(args):
            return self._as_python
        begin, collects = time.perf_counter(), gc.isenabled()
        gc.disable()  # the search for cycles takes a fifth of a compilation, since it makes millions of objects
        try:
            return super()._compile_for_args(*args)
        finally:
            _loading.set(loading() + time.perf_counter() - begin)
            if collects:
                gc.enable()

    def _as_python(self, *args: Any) -> Any:
        """The result of the interpreter."""
        with np.errstate(all="ignore"):
            return scalars(plain(self.__module__)[self.__name__](*args))


@cache
def ask(kernel: Kernel, types: Any) -> bool:
    """Have a process compile it, one of the user's, which goes on when this one ends; False where none can."""
    if os.environ.get(PROCESSES) == "1" or not (place := folder()):
        return False
    announce()
    save(kernel.file(types).with_suffix(".ask"), (kernel.__module__, kernel.__name__, types))
    code = f"import sys; sys.path[:] = {sys.path}; from nsdyn._kernels.compiled import work; work()"
    command, none = [sys.executable, "-c", code], dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.DEVNULL)
    with suppress(OSError), open(place / "lock", "w") as lock:  # it is locked while the process has it open
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        _processes.append(subprocess.Popen(command, start_new_session=True, pass_fds=[lock.fileno()], **none))
    return True


def is_ready(function: Callable[..., Any], *args: Any) -> bool:
    """Whether a call need not wait for what another process compiles."""
    return not isinstance(function, Kernel) or function.is_quick(args) or not function.is_missing(args)


def asked() -> list[Path]:
    """What is still to be compiled, as it was asked for."""
    return sorted((folder() or Path()).glob("*.ask"), key=lambda file: file.stat().st_mtime)


def answer(file: Path) -> None:
    """Compile what was asked for."""
    if request := load(file):
        module, name, types = request
        try:
            kernel = getattr(import_module(module), name)
            if not kernel.file(types).exists():
                kernel.compile(types)
        finally:
            file.unlink(missing_ok=True)


def work() -> None:
    """Compile what is asked for, the last first: what a run calls all the time is called after what begins it."""
    gc.disable()
    last = time.monotonic()
    while time.monotonic() < last + LINGER:
        with suppress(Exception):  # there is none; what cannot be compiled is told to who waits for it
            answer(asked()[-1])
            last = time.monotonic()
        time.sleep(0.1)


def load(file: Path) -> Any:
    """What was kept, None if nothing was."""
    with suppress(OSError):
        os.utime(file)
        return pickle.loads(file.read_bytes())


def save(file: Path, kept: Any) -> None:
    """Keep it, whole or not at all; a full disk costs a compilation at the next start."""
    with suppress(OSError), tempfile.TemporaryDirectory(dir=file.parent) as part:
        Path(part, file.name).write_bytes(dumps(kept))
        os.replace(Path(part, file.name), file)


def kernel(function: Callable[..., Any] | None = None, rounds: int = 1, **options: Any) -> Any:
    """Decorator of a kernel; how often about it goes through what it is given, and options as of `numba.njit`."""
    if function is None:
        return partial(kernel, rounds=rounds, **options)
    if config.DISABLE_JIT:
        return function
    # What is left open numba takes from the kernel that calls this one first, and keeps for all others.
    always = {"nopython": True, "boundscheck": None, "fastmath": False, "_nrt": True}
    out = Kernel(function, targetoptions=always | options)
    out.rounds = rounds
    return out


def no_alloc(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """Decorator of a kernel that makes no arrays, and calls none that returns them: it works in those it is given.

    It does not count references to these, which numba does for arrays in tuples and for parts of arrays, and which
    takes longer than what many small kernels do.
    """
    return kernel(function, _nrt=False, **options)
