"""Numba kernels, each short, and each with a slow reference implementation in tests/naive.py.

Import them in the functions that call them: numba takes long to import.
"""

# A detector with less than this fraction of the mean power is dead or stuck: its power is rounding of its mean.
DEAD_POWER = 1e-16
