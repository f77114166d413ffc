"""Numba loops, each short, each with a slow twin in tests/naive.py."""
