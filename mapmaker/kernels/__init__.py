"""Numba loops, each short, each with a slow twin in tests/naive.py.

Import them in the functions that call them: numba takes long to import.
"""

# A detector with less than this fraction of the mean power is dead or stuck: what is left is rounding of
# its mean.
DEAD_POWER = 1e-16
