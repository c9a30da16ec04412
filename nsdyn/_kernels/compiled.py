"""The decorator of all kernels.

numba makes machine code of every function that it compiles, with an entry from Python and one from C, and optimises it
with all that it calls, again for each caller. Here only what Python calls is made machine code of, with all below it,
once: of a kernel that kernels call there is LLVM's code, simplified function by function. Both are kept, see
`nsdyn._kernels.cache`.
"""

from __future__ import annotations

import gc
import logging
import threading
import time
from collections.abc import Callable
from functools import cached_property, lru_cache, partial
from pathlib import Path
from typing import Any, ClassVar

import llvmlite.binding as llvm
from numba.core import config, typing
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompileResult, Flags, compile_extra, compile_result
from numba.core.registry import CPUDispatcher
from numba.core.types import unliteral

from nsdyn._kernels.cache import Cache, alone

PATIENCE = 2.0
"""s of loading and compiling in a process about which nothing is said."""


class _Loading(threading.local):
    seconds = 0.0


_loading = _Loading()


def loading() -> float:
    """How long this thread has waited for kernels to be loaded or compiled, s."""
    return _loading.seconds


def clock() -> float:
    """Time in s since some moment, without `loading`."""
    return time.perf_counter() - _loading.seconds


@lru_cache(maxsize=1)
def announce() -> None:
    """Tell, once in a process, that kernels are compiled."""
    logging.getLogger("nsdyn").warning("compiling kernels that are new to this machine: half a minute or more")


class Linkable(JITCodeLibrary):
    """LLVM code of a function and of those it calls, which is not run by itself."""

    def _optimize_final_module(self) -> None:
        """Nothing: its callers are optimised with it."""

    def _finalize_final_module(self) -> None:
        """No machine code."""
        self._finalize_dynamic_globals()
        self._finalized = True


class Called:
    """What kernels call of a kernel.

    Parameters
    ----------
    kernel : Kernel
    """

    def __init__(self, kernel: Kernel) -> None:
        self._function, self._context, self._typing = kernel.py_func, kernel.targetctx, kernel.typingctx
        self._flags = Flags()
        kernel.targetdescr.options.parse_as_flags(self._flags, kernel.targetoptions)
        self._flags.no_compile = self._flags.no_cpython_wrapper = self._flags.no_cfunc_wrapper = True
        self._cache = Cache(kernel.py_func, "LLVM code")
        self._results: dict[Any, CompileResult] = {}

    def __getitem__(self, types: Any) -> CompileResult:
        """Compiled or loaded for these types of arguments."""
        if types not in self._results:
            with alone(self._cache.file(types, self._context)):
                kept = self._cache.load(types, self._context)
                result = self._compile(types) if kept is None else self._rebuild(*kept)
            # By its entry, an address, numba finds how a function is called: any object that is no other's will do
            result = result._replace(entry_point=object())
            self._context.insert_user_function(result.entry_point, result.fndesc, [result.library])
            self._results[types] = result
        return self._results[types]

    def _compile(self, types: Any) -> CompileResult:
        result = compile_extra(self._typing, self._context, self._function, types, None, self._flags.copy(), {})
        library, description = result.library, result.fndesc
        library.__class__ = Linkable
        description.typemap = description.calltypes = None  # as numba does: of no use, and not to be pickled
        _, _, code = library.serialize_using_bitcode()
        kept = library.name, code, description, result.environment, result.signature, result.reload_init
        self._cache.save(types, self._context, kept)
        return result

    def _rebuild(self, name: str, code: bytes, description: Any, environment: Any, signature: Any, init: Any) -> Any:
        for load in init:
            load()
        library = Linkable(self._context.codegen(), name)
        library._final_module = llvm.parse_bitcode(code)
        library._finalize_final_module()
        return compile_result(
            typing_context=self._typing,
            target_context=self._context,
            library=library,
            fndesc=description,
            environment=environment,
            signature=signature,
            reload_init=init,
            objectmode=False,
        )


class Notes:
    """Calls of kernels from Python, in their order, while all kernels run as Python."""

    def __init__(self) -> None:
        self.calls: dict[tuple[Kernel, Any], None] = {}
        self._inside = False

    def call(self, kernel: Kernel, *args: Any, **kws: Any) -> Any:
        """Run a kernel as Python; those it calls are none of Python's."""
        if self._inside:
            return kernel.py_func(*args, **kws)
        types = tuple(map(kernel.typeof_pyval, args)), {k: kernel.typeof_pyval(v) for k, v in kws.items()}
        self.calls[kernel, tuple(kernel.fold_argument_types(*types)[1])] = None
        self._inside = True
        try:
            return kernel.py_func(*args, **kws)
        finally:
            self._inside = False


class Kernel(CPUDispatcher):
    """Compiled function: compiled by one process while others wait, and for variables where it is given constants."""

    notes: ClassVar[Notes | None] = None
    """Where not None, nothing is compiled."""

    prepare: ClassVar[Callable[[], None]] = staticmethod(lambda: None)
    """Called before a process compiles what Python calls."""

    later: ClassVar[Callable[[Path, bool], bool]] = staticmethod(lambda file, begin: False)
    """Whether other processes compile what is kept in a file, or will; they begin now or need not yet."""

    cache_path = None
    """Of what `stats` tells of a cache."""

    def enable_caching(self) -> None:
        """As numba does, in our cache."""
        self._cache, self.kept = self, Cache(self.py_func, "machine code")

    def load_overload(self, types: Any, context: Any) -> CompileResult | None:
        """What numba asks of a cache."""
        kept = self.kept.load(types, context)
        if kept is not None:
            return CompileResult._rebuild(context, *kept)
        Kernel.prepare()
        if _loading.seconds > PATIENCE:
            announce()
        return None

    def save_overload(self, types: Any, result: CompileResult) -> None:
        """What numba tells a cache."""
        self.kept.save(types, result.target_context, result._reduce())

    @cached_property
    def called(self) -> Called:
        """What other kernels call."""
        return Called(self)

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """Meaning of a call in another kernel; numba would compile f(0) and f(i) both."""
        types = tuple(map(unliteral, args)), {name: unliteral(t) for name, t in kws.items()}
        signature, folded = self._compiler.fold_argument_types(*types)
        name = self.py_func.__name__
        found = typing.make_concrete_template(name, key=name, signatures=[self.called[tuple(folded)].signature])
        return found, signature, folded, {}

    def get_overload(self, types: Any) -> Any:
        """What numba knows the function by that another kernel calls."""
        return self.called[tuple(types)].entry_point

    def _compile_for_args(self, *args: Any, **kws: Any) -> Any:
        """What to call instead, at a call from Python with new types."""
        if Kernel.notes is not None:
            return partial(Kernel.notes.call, self)
        begin = time.perf_counter()
        try:
            return super()._compile_for_args(*args, **kws)
        finally:
            _loading.seconds += time.perf_counter() - begin

    def compile(self, types: Any, wait: bool = True) -> Any:
        """Load or compile for these types; without waiting None where another process does."""
        if types in self.overloads:
            return super().compile(types)
        collects = gc.isenabled()
        gc.disable()  # the search for cycles takes a fifth of a compilation, since it makes millions of objects
        try:
            with alone(self.kept.file(types, self.targetctx), wait) as free:
                return super().compile(types) if free else None
        finally:
            if collects:
                gc.enable()

    def is_ready(self, begin: bool, *args: Any) -> bool:
        """Whether a call with such arguments need not wait for more than loading; if not, `later` it need not."""
        if Kernel.notes is not None:
            return begin
        types = tuple(map(self.typeof_pyval, args))
        if types in self.overloads:
            return True
        file = self.kept.file(types, self.targetctx)
        return file is None or file.exists() or not Kernel.later(file, begin)


def kernel(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """Decorator of a kernel; options as of `numba.njit`."""
    if function is None:
        return lambda function: kernel(function, **options)
    if config.DISABLE_JIT:
        return function
    # What is left open numba takes from the kernel that calls this one first, and keeps for all others.
    always = {"nopython": True, "boundscheck": None, "fastmath": False, "_nrt": True}
    out = Kernel(function, targetoptions=always | options)
    out.enable_caching()
    return out


def is_ready(function: Callable[..., Any], begin: bool, *args: Any) -> bool:
    """Whether a kernel can be called with such arguments at once; if not, another process may begin to compile it."""
    return not isinstance(function, Kernel) or function.is_ready(begin, *args)


def in_place(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """Decorator of a kernel that makes no arrays, and calls none that returns them: it works in those it is given.

    It does not count references to these, which numba does for arrays in tuples and for parts of arrays, and which
    takes longer than what many small kernels do.
    """
    return kernel(function, _nrt=False, **options)
