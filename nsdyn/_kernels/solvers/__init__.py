"""Kernels of `nsdyn.solvers`."""
