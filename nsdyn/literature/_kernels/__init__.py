"""Kernels of the methods from the literature."""
