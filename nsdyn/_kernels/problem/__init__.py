"""Kernels of `nsdyn.problem`."""
