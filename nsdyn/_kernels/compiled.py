"""The decorator of all kernels, and what it adds to numba's.

numba makes machine code of every function that it compiles, with all that it calls, again for each caller; of kernels
that only kernels call nobody uses it. Here these stop at LLVM's code, simplified function by function, and what Python
calls is optimised and translated with all below it, once. That is a third of a compilation.
"""

import gc
import logging
import multiprocessing
import os
import threading
import time
from collections.abc import Callable
from functools import lru_cache
from typing import Any, ClassVar

from numba import config, types
from numba.core import compiler, typing
from numba.core.registry import CPUDispatcher

from nsdyn._kernels import cache

PATIENCE = 2.0
"""s of compiling about which nothing is said."""


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
def _tell() -> None:
    """Tell who waits, once."""
    if multiprocessing.parent_process() is None:
        logging.getLogger("nsdyn").warning("compiling kernels, once on this machine: about half a minute")


class _Flags(compiler.Flags):  # type: ignore[misc]  # numba is not typed
    """Options that are told apart by what is set of them: numba looks all up by name, a seventh of a compilation."""

    def __hash__(self) -> int:
        return len(self._values)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, compiler.Flags) and self._values == other._values


class Kernel(CPUDispatcher):  # type: ignore[misc]  # numba is not typed
    """Compiled function: compiled by one process while others wait, and for variables where it is given constants."""

    notes: ClassVar[dict[tuple["Kernel", Any], None] | None] = None
    """Where not None, kernels run as Python, and what Python calls of them is noted here."""

    new: ClassVar[Callable[[], None]] = staticmethod(lambda: None)
    """Called where nothing is known of what is compiled."""

    def __init__(self, *args: Any, **kws: Any) -> None:
        super().__init__(*args, **kws)
        self._compiler.compile = self._machine_code
        self._codes: dict[Any, Any] = {}

    def _code(self, given: Any) -> Any:
        """LLVM's code for these types of arguments, as other kernels call it."""
        made = self._codes.get(given) or self.overloads.get(given)  # these are from the cache
        if made is None:
            flags = compiler.Flags()
            self.targetdescr.options.parse_as_flags(flags, self.targetoptions)
            flags.no_compile = flags.no_cpython_wrapper = flags.no_cfunc_wrapper = True
            made = compiler.compile_extra(self.typingctx, self.targetctx, self.py_func, given, None, _Flags(flags), {})
            # By its entry, an address, numba finds how a function is called: any object that is no other's will do
            made = made._replace(entry_point=object())
            # It stays as it is, and its callers are linked with what it calls: each after all that call it
            made.library._finalized = True
            below = made.library._linking_libraries
            below[:] = [*dict.fromkeys(below[::-1])][::-1]
            self.targetctx.insert_user_function(made.entry_point, made.fndesc, [made.library, *below])
            self._codes[given] = made
        return made

    def _machine_code(self, given: Any, _: None) -> Any:
        """That with an entry for Python, optimised and translated with all it calls."""
        made = self._code(given)
        made.library._finalized, made.library._shared_module, context = False, None, made.target_context
        context.create_cpython_wrapper(made.library, made.fndesc, made.environment, made.call_helper)
        return made._replace(entry_point=context.get_executable(made.library, made.fndesc, made.environment))

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """Meaning of a call in another kernel; numba would compile f(0) and f(i) both."""
        plain = tuple(map(types.unliteral, args)), {name: types.unliteral(t) for name, t in kws.items()}
        signature, folded = self._compiler.fold_argument_types(*plain)
        name, known = self.py_func.__name__, [self._code(tuple(folded)).signature]
        return typing.make_concrete_template(name, key=name, signatures=known), signature, folded, {}

    def get_overload(self, given: Any) -> Any:
        """What numba knows the function by that another kernel calls."""
        return self._code(tuple(given)).entry_point

    def _compile_for_args(self, *args: Any, **kws: Any) -> Any:
        """What to call instead, at a call from Python with new types."""
        if Kernel.notes is not None:
            return self._noted
        begin = time.perf_counter()
        try:
            return super()._compile_for_args(*args, **kws)
        finally:
            _loading.seconds += time.perf_counter() - begin

    def _noted(self, *args: Any, **kws: Any) -> Any:
        """Run as Python; the kernels it calls are none of Python's."""
        given = tuple(map(self.typeof_pyval, args)), {name: self.typeof_pyval(v) for name, v in kws.items()}
        notes, Kernel.notes = Kernel.notes, {}
        notes[self, tuple(self.fold_argument_types(*given)[1])] = None
        try:
            return self.py_func(*args, **kws)
        finally:
            Kernel.notes = notes

    def compile(self, given: Any, wait: bool = True) -> Any:
        """Load or compile for these types; without waiting None where another process does.

        Without the search for garbage, which takes a fifth of a compilation, since it makes millions of objects.
        """
        place, enabled = self._cache.cache_path, gc.isenabled()
        if place and not os.path.exists(place):
            Kernel.new()
        gc.disable()
        # To load takes less than that quarter
        timer = threading.Timer(max(0.25 * PATIENCE, PATIENCE - loading()), _tell)
        timer.daemon = True
        timer.start()
        try:
            with cache.alone(place, self.py_func.__name__, wait) as free:
                return super().compile(given) if free else None
        except OSError:  # a full disk: it is compiled, and not kept
            return super().compile(given)
        finally:
            timer.cancel()
            if enabled:
                gc.enable()


def kernel(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """Decorator of a kernel; options as of `numba.njit`."""
    if function is None:
        return lambda function: kernel(function, **options)
    if config.DISABLE_JIT:
        return function
    # What is left open numba takes from the kernel that calls this one first, and keeps for all others.
    always = {"nopython": True, "boundscheck": None, "fastmath": False, "_nrt": True}
    out = Kernel(function, targetoptions=always | options)
    if cache.folder() is not None:
        before, config.CACHE_LOCATOR_CLASSES = config.CACHE_LOCATOR_CLASSES, cache.__name__
        out.enable_caching()
        config.CACHE_LOCATOR_CLASSES = before
    return out


def in_place(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """Decorator of a kernel that makes no arrays, and calls none that returns them: it works in those it is given.

    It does not count references to these, which numba does for arrays in tuples and for parts of arrays, and which
    takes longer than what many small kernels do.
    """
    return kernel(function, _nrt=False, **options)
