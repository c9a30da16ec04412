"""The decorator of all kernels, and the files of their compiled code: no run waits for the compiler.

The interpreter runs a kernel that has no machine code yet, with the same bits, while another process compiles it. Only
calls with many numbers wait for machine code.

By default numba makes machine code of every function that it compiles, with entries from Python and from C, and
optimises it together with all functions that it calls, again for each caller. That takes half as long again. Here only
kernels that Python calls become machine code, together with all kernels below them. Of a kernel that kernels call,
LLVM's code is kept.

Both kinds of code are files in a folder of the user. A file is named by a hash of all its inputs: the text of the
kernel's module and of the nsdyn modules that it imports, types of arguments, processor and versions. A file is
therefore never out of date, and all environments share the folder.
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
"""Environment variables: the folder of the files; and the number of processes that compile. If the latter is 1, only
the calling process compiles, and waits."""

KEEP, LINGER, PATIENCE = 60 * 86400.0, 5.0, 2.0
"""Three times in s: how long a file is kept after its last use, how long a compiling process looks for further
requests, and how long loading and compiling may take before the user is told."""

LARGE = 100_000
"""Numbers processed in a call above which the call waits for machine code: the interpreter takes a tenth of a second
for so many."""

VERSIONS = sys.implementation.cache_tag, numba.__version__, np.__version__

_IMPORT = re.compile(r"^(?:from|import) +(nsdyn[\w.]*)(?: +import +(\([^)]*\)|.*))?", re.MULTILINE)

_loading = ContextVar("seconds", default=0.0)
loading = _loading.get  # time that this thread has waited for kernels to be loaded or compiled, s
waiting: list[object] = []  # callers that measure times; if there are any, all threads wait for kernels
_processes: list[subprocess.Popen[bytes]] = []  # compiling; kept here, or Python would warn at exit that they still run


def clock() -> float:
    """Time in s since an arbitrary moment, without the time of `loading`."""
    return time.perf_counter() - loading()


@cache
def announce() -> None:
    """Log, once per process, that kernels are being compiled."""
    logging.getLogger("nsdyn").warning("kernels that are new to this machine are compiled: a slow minute or two")


@cache
def folder() -> Path | None:
    """Folder of the files, created if it does not exist; None if it is not writable."""
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
    """Hash of the text of a module and of the contents of the nsdyn modules that it imports."""
    text, names = Path(sys.modules[module].__file__ or "").read_text(encoding="utf-8"), set()
    for package, parts in _IMPORT.findall(text):
        names |= {".".join((package, *part.split()[:1])) for part in ("", *parts.strip("()").split(","))}
    return hashlib.sha256("".join((text, *map(content, sorted(names & sys.modules.keys())))).encode()).hexdigest()


@cache
def plain(module: str) -> dict[str, Any]:
    """Names of a module of kernels, with each kernel replaced by its plain Python function."""
    names = dict(vars(sys.modules[module]))
    for name, value in list(names.items()):
        if isinstance(value, Kernel):
            own = names if value.__module__ == module else plain(value.__module__)
            names[name] = FunctionType(value.py_func.__code__, own)
        elif isinstance(value, ModuleType) and value.__name__.startswith("nsdyn."):
            names[name] = SimpleNamespace(**plain(value.__name__))
    return names


def size(x: Any) -> int:
    """Count the numbers in the arguments of a kernel."""
    return sum(map(size, x)) if isinstance(x, tuple) else getattr(x, "size", 1)


def scalars(x: Any) -> Any:
    """Convert NumPy's numbers in the result of a kernel to Python's, which a compiled kernel returns."""
    return tuple(map(scalars, x)) if type(x) is tuple else x.item() if isinstance(x, np.generic) else x


class Kernel(CPUDispatcher):
    """Compiled function; constant arguments are compiled as variables."""

    cache_path = None  # attribute that numba's `stats` expects of a cache
    rounds = 1

    def __init__(self, function: Callable[..., Any], *others: Any, **options: Any) -> None:
        super().__init__(function, *others, **options)
        # Read the text now, since it may be edited before the first call.
        self._cache, self._callees, self._content = self, {}, content(function.__module__)

    @cache  # noqa: B019 (kernels stay)
    def file(self, types: Any, form: str = "machine code") -> Path:
        """File of this kernel for these types; without a folder, a path that cannot be read or written."""
        self.targetctx.refresh()
        made_of = form, self._content, str(types), self.targetctx.codegen().magic_tuple(), VERSIONS, config.BOUNDSCHECK
        name = f"{self.py_func.__module__.rpartition('.')[2]}.{self.py_func.__qualname__}"
        key = hashlib.sha256(repr((name, *made_of)).encode()).hexdigest()
        return Path(folder() or os.devnull, f"{name}-{key[:32]}.nbc")

    def load_overload(self, types: Any, context: Any) -> CompileResult | None:
        """Load a compiled kernel; part of numba's interface of a cache."""
        if kept := load(self.file(types)):
            return CompileResult._rebuild(context, *kept)
        if loading() > PATIENCE:
            announce()
        return None

    def save_overload(self, types: Any, result: CompileResult) -> None:
        """Save a compiled kernel; part of numba's interface of a cache.

        numba would save its LLVM code, too, and read that at every start. Of it only the names of the entries are used.
        """
        (name, kind, (code, _)), description, *others = result._reduce()
        entries = description.llvm_func_name, description.llvm_cpython_wrapper_name
        named = llvm.parse_assembly("".join(f'define void @"{entry}"() {{ ret void }}' for entry in entries))
        save(self.file(types), ((name, kind, (code, named.as_bitcode())), description, *others))

    def callee(self, types: Any) -> tuple[Any, object, Any]:
        """(signature, entry, environment) for calls from other kernels, which use LLVM's code."""
        if types not in self._callees:
            if not (kept := load(self.file(types, "LLVM code"))):
                kept = self._lower(types)
                save(self.file(types, "LLVM code"), kept)
            name, code, description, environment, signature, initialisations = kept
            for initialise in initialisations:
                initialise()
            library = self.targetctx.codegen().create_library(name)
            library._final_module, library._finalized = llvm.parse_bitcode(code), True
            # From the entry, an address, numba finds how a function is called. Any unique object will do.
            self._callees[types] = out = signature, object(), environment
            self.targetctx.insert_user_function(out[1], description, [library])
        return self._callees[types]

    def _lower(self, types: Any) -> tuple[Any, ...]:
        """LLVM's code for these types, simplified function by function; it is optimised later, with its callers."""
        flags = Flags()
        self.targetdescr.options.parse_as_flags(flags, self.targetoptions)
        flags.no_compile = flags.no_cpython_wrapper = flags.no_cfunc_wrapper = True
        result = compile_extra(self.typingctx, self.targetctx, self.py_func, types, None, flags, {})
        library, description = result.library, result.fndesc
        library._optimize_final_module = library._finalize_final_module = lambda: None
        library.finalize()
        description.typemap = description.calltypes = None  # as numba does: of no use, and should not be pickled
        code = library._final_module.as_bitcode()
        return library.name, code, description, result.environment, result.signature, result.reload_init

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """Signature of a call in another kernel. Literal types are dropped: numba would compile both f(0) and f(i)."""
        signature, folded = self._compiler.fold_argument_types(tuple(map(unliteral, args)), kws)
        name = self.py_func.__name__
        found = typing.make_concrete_template(name, key=name, signatures=[self.callee(tuple(folded))[0]])
        return found, signature, folded, {}

    def get_overload(self, types: Any) -> Any:
        """Object by which numba identifies this function when another kernel calls it."""
        return self.callee(tuple(types))[1]

    def is_quick(self, args: Any) -> bool:
        """True if the interpreter is fast enough for these arguments."""
        return not waiting and self.rounds * size(args) <= LARGE

    def is_missing(self, args: Any) -> bool:
        """True if no machine code exists yet and another process compiles it."""
        types = tuple(map(self.typeof_pyval, args))
        return not self.file(types).exists() and ask(self, types)

    def _compile_for_args(self, *args: Any) -> Any:
        """Return the function to call instead, at a call from Python with new types of arguments."""
        if self.is_quick(args) and self.is_missing(args):
            return self._as_python
        begin, collects = time.perf_counter(), gc.isenabled()
        gc.disable()  # garbage collection takes a fifth of a compilation, which makes millions of objects
        try:
            return super()._compile_for_args(*args)
        finally:
            _loading.set(loading() + time.perf_counter() - begin)
            if collects:
                gc.enable()

    def _as_python(self, *args: Any) -> Any:
        """Run the kernel in the interpreter."""
        with np.errstate(all="ignore"):
            return scalars(plain(self.__module__)[self.__name__](*args))


@cache
def ask(kernel: Kernel, types: Any) -> bool:
    """Request a compilation from a process of the user, which outlives this one; False if no process can compile."""
    if os.environ.get(PROCESSES) == "1" or not (place := folder()):
        return False
    announce()
    save(kernel.file(types).with_suffix(".ask"), (kernel.__module__, kernel.__name__, types))
    code = f"import sys; sys.path[:] = {sys.path}; from nsdyn._kernels.compiled import work; work()"
    command, none = [sys.executable, "-c", code], dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.DEVNULL)
    with suppress(OSError), open(place / "lock", "w") as lock:  # the process keeps it open, and so locked
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        _processes.append(subprocess.Popen(command, start_new_session=True, pass_fds=[lock.fileno()], **none))
    return True


def is_ready(function: Callable[..., Any], *args: Any) -> bool:
    """True if a call need not wait for a compilation in another process."""
    return not isinstance(function, Kernel) or function.is_quick(args) or not function.is_missing(args)


def asked() -> list[Path]:
    """Files of the compilations that are still requested, oldest first."""
    return sorted((folder() or Path()).glob("*.ask"), key=lambda file: file.stat().st_mtime)


def answer(file: Path) -> None:
    """Compile the kernel of a request."""
    if request := load(file):
        module, name, types = request
        try:
            kernel = getattr(import_module(module), name)
            if not kernel.file(types).exists():
                kernel.compile(types)
        finally:
            file.unlink(missing_ok=True)


def work() -> None:
    """Compile requested kernels, the latest request first.

    The kernels that a run calls throughout are requested after those that it calls at its start.
    """
    gc.disable()
    last = time.monotonic()
    while time.monotonic() < last + LINGER:
        with suppress(Exception):  # no request, or a failed compilation: the waiting process reports its error
            answer(asked()[-1])
            last = time.monotonic()
        time.sleep(0.1)


def load(file: Path) -> Any:
    """Read a saved object; None if there is no file."""
    with suppress(OSError):
        os.utime(file)
        return pickle.loads(file.read_bytes())


def save(file: Path, kept: Any) -> None:
    """Write an object to a file, completely or not at all. A full disk costs one compilation at the next start."""
    with suppress(OSError), tempfile.TemporaryDirectory(dir=file.parent) as part:
        Path(part, file.name).write_bytes(dumps(kept))
        os.replace(Path(part, file.name), file)


def kernel(function: Callable[..., Any] | None = None, rounds: int = 1, **options: Any) -> Any:
    """Decorator of a kernel that passes over its arguments about `rounds` times; options as of `numba.njit`."""
    if function is None:
        return partial(kernel, rounds=rounds, **options)
    if config.DISABLE_JIT:
        return function
    # Set every option: numba takes missing ones from the kernel that is the first caller, and keeps them for all
    # others.
    always = {"nopython": True, "boundscheck": None, "fastmath": False, "_nrt": True}
    out = Kernel(function, targetoptions=always | options)
    out.rounds = rounds
    return out


def no_alloc(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """Decorator of a kernel that makes no arrays and calls no kernel that returns some: it works in given arrays.

    Such a kernel does not count references to arrays. numba counts them for arrays in tuples and for parts of arrays,
    which takes longer than the work of many small kernels.
    """
    return kernel(function, _nrt=False, **options)
