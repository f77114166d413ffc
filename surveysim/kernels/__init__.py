"""Numba loops of the simulator, each short, each with a slow twin in tests/naive.py."""
