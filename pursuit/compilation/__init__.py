"""Compilation of kernels by Numba, and its cache on disk."""
