"""The decorator of all kernels.

What Python calls is compiled to machine code; what kernels call is not, see `nsdyn._kernels.called`. Both are kept, see
`nsdyn._kernels.cache`.
"""

import gc
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cached_property, partial
from typing import Any, ClassVar

from numba.core import config, typing
from numba.core.registry import CPUDispatcher
from numba.core.types import unliteral

from nsdyn._kernels.cache import Cache, alone
from nsdyn._kernels.called import Called


@contextmanager
def _no_garbage() -> Iterator[None]:
    """Without the search for cycles, which takes a fifth of a compilation, since it makes millions of objects."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


class _Loading(threading.local):
    seconds = 0.0


_loading = _Loading()


def loading() -> float:
    """How long this thread has waited for kernels to be loaded or compiled, s."""
    return _loading.seconds


def clock() -> float:
    """Time in s since some moment, without `loading`."""
    return time.perf_counter() - _loading.seconds


class Notes:
    """Calls of kernels from Python, in their order, while all kernels run as Python."""

    def __init__(self) -> None:
        self.calls: dict[tuple[Kernel, Any], None] = {}
        self._inside = False

    def call(self, kernel: "Kernel", *args: Any, **kws: Any) -> Any:
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

    known: ClassVar[list["Kernel"]] = []
    notes: ClassVar[Notes | None] = None
    """Where not None, nothing is compiled."""

    prepare: ClassVar[Callable[[], None]] = staticmethod(lambda: None)
    """Called before a process compiles what Python calls."""

    def enable_caching(self) -> None:
        """As numba does, in our cache."""
        self._cache = Cache(self.py_func)
        self.known.append(self)

    @property
    def name(self) -> str:
        """Module, name and contents: the beginning of the names of its files."""
        return self._cache.name

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
            Kernel.prepare()
            return super()._compile_for_args(*args, **kws)
        finally:
            _loading.seconds += time.perf_counter() - begin

    def compile(self, types: Any, wait: bool = True) -> Any:
        """Load or compile for these types; without waiting None where another process does."""
        if types in self.overloads:
            return super().compile(types)
        with _no_garbage(), alone(self._cache.file(types, self.targetctx), wait) as free:
            return super().compile(types) if free else None


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


def in_place(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """Decorator of a kernel that makes no arrays, and calls none that returns them: it works in those it is given.

    It does not count references to these, which numba does for arrays in tuples and for parts of arrays, and which
    takes longer than what many small kernels do.
    """
    return kernel(function, _nrt=False, **options)
