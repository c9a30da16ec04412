"""Kernels of `nsdyn.stepping`."""
