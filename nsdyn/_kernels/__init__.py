"""Compiled kernels: functions of arrays and scalars, the only place where numba is imported.

They are in folders like those of the core, whose modules call them; `nsdyn.literature` has its own. Each gives the same
bits as plain Python: no sum is reordered or fused, a square is a product, and functions are those of C. So nobody need
wait for the compiler: `nsdyn._kernels.compiled` tells how.
"""
