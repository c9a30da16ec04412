"""Kernels of `nsdyn.problem.fc3d`."""
