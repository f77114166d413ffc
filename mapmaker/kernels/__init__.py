"""Numba kernels, each short, and each with a slow reference implementation in tests/naive.py."""
