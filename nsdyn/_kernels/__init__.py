"""Compiled kernels: functions of arrays and scalars. numba is imported nowhere else.

Their folders mirror those of the core, whose modules call them; `nsdyn.literature` has its own kernels. Each kernel
gives the same bits as plain Python: no sum is reordered or fused, a square is a product, and functions are those of C.
Therefore no run has to wait for the compiler: `nsdyn._kernels.compiled` explains how.
"""
