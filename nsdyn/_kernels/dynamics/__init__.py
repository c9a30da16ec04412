"""Kernels of `nsdyn.dynamics.dynamics`."""
