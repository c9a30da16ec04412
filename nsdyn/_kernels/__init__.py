"""Compiled kernels: functions of arrays and scalars, the only place where numba is imported.

Each kernel has a NumPy twin of the same meaning, in `nsdyn.cones`, `nsdyn.problem` or its test, and gives the same
answer with ``NUMBA_DISABLE_JIT=1``.

For developers: numba's cache sees a change of a kernel's own file only. After editing a kernel that another file calls,
delete ``_kernels/__pycache__``.
"""
