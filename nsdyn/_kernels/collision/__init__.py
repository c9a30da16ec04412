"""Kernels of `nsdyn.collision`."""
