"""Kernels as other kernels call them: code that is optimised and translated to machine code with its callers' only.

numba makes machine code of every function that it compiles, with an entry from Python and one from C, and optimises it
with all that it calls, again for each caller; of kernels that only kernels call that is a third of a compilation, and
nobody uses it. Here they are lowered to LLVM's code and simplified function by function, no more: what Python calls is
optimised with all below it, once.
"""

from __future__ import annotations

from typing import Any

import llvmlite.binding as llvm
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompileResult, Flags, compile_result
from numba.core.dispatcher import Dispatcher, _FunctionCompiler

from nsdyn._kernels.cache import Cache, alone

__all__ = ["Called"]


class Linkable(JITCodeLibrary):
    """LLVM code of a function and of those it calls, which is not run by itself."""

    def _optimize_final_module(self) -> None:
        """Nothing: its callers are optimised with it."""

    def _finalize_final_module(self) -> None:
        """No machine code."""
        self._finalize_dynamic_globals()
        self._finalized = True


class LinkableCache(Cache):
    """LLVM code of a function for each list of types of arguments."""

    form = "LLVM code"

    def reduce(self, result: CompileResult) -> tuple[Any, ...]:
        """What of a compiled function is kept."""
        result.fndesc.typemap = result.fndesc.calltypes = None  # as numba does: of no use, and not to be pickled
        _, _, code = result.library.serialize_using_bitcode()
        return result.library.name, code, result.fndesc, result.environment, result.signature, result.reload_init

    def rebuild(self, context: Any, kept: tuple[Any, ...]) -> CompileResult:
        """The compiled function of what was kept."""
        name, code, description, environment, signature, reload_init = kept
        for load in reload_init:
            load()
        library = Linkable(context.codegen(), name)
        library._final_module = llvm.parse_bitcode(code)
        library._finalize_final_module()
        return compile_result(
            typing_context=context.typing_context,
            target_context=context,
            library=library,
            fndesc=description,
            environment=environment,
            signature=signature,
            reload_init=reload_init,
            entry_point=None,
            objectmode=False,
        )


class _Lowered(_FunctionCompiler):
    """Compiler that stops before machine code."""

    def _customize_flags(self, flags: Flags) -> Flags:
        flags.no_compile = flags.no_cpython_wrapper = flags.no_cfunc_wrapper = True
        return flags


class Called:
    """What kernels call of a kernel.

    Parameters
    ----------
    kernel : numba.core.dispatcher.Dispatcher
    """

    def __init__(self, kernel: Dispatcher) -> None:
        of = kernel._compiler
        self._compiler = _Lowered(of.py_func, of.targetdescr, of.targetoptions, of.locals, of.pipeline_class)
        self._context = kernel.targetctx
        self._cache = LinkableCache(kernel.py_func)
        self._results: dict[Any, CompileResult] = {}

    def __getitem__(self, types: Any) -> CompileResult:
        """Compiled or loaded for these types of arguments."""
        if types not in self._results:
            with alone(self._cache.file(types, self._context)):
                result = self._cache.load_overload(types, self._context) or self._compile(types)
            # By its entry, an address, numba finds how a function is called: any object that is no other's will do
            result = result._replace(entry_point=object())
            self._context.insert_user_function(result.entry_point, result.fndesc, [result.library])
            self._results[types] = result
        return self._results[types]

    def _compile(self, types: Any) -> CompileResult:
        result = self._compiler.compile(types, None)
        result.library.__class__ = Linkable
        self._cache.save_overload(types, result)
        return result
