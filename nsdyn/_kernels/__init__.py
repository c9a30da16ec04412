"""Compiled kernels: functions of arrays and scalars, the only place where numba is imported.

They are in folders like those of the core, whose modules call them; `nsdyn.literature` has its own. Each gives the same
numbers as plain Python, with ``NUMBA_DISABLE_JIT=1``. The first use on a machine compiles them and keeps the
machine code in a folder of the user, as `nsdyn._kernels.cache` tells; the logger "nsdyn" says so to whoever waits.
"""

from nsdyn._kernels import ahead

__all__ = ["ahead"]
