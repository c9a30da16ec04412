"""Compiled kernels: functions of arrays and scalars, the only place where numba is imported.

They are in folders like those of the core, whose modules call them; `nsdyn.literature` has its own. Each gives the same
numbers as plain Python, with ``NUMBA_DISABLE_JIT=1``. `nsdyn._kernels.compiled` tells how they are compiled, and kept.
"""
