"""Seeded mangled inputs of every kind that the program reads, each tried in a process of its own.

`python -m tests.fuzz.server KIND NUMBER SEED [FIRST]` tries inputs by hand and prints what failed.
"""
