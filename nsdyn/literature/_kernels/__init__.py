"""Kernels of the methods of the literature."""
