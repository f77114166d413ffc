"""The Python interface: a function for each command that computes results, and equal results.

`surveysim.api.public` has those that take scenes and sweeps of one band or of several.
"""
