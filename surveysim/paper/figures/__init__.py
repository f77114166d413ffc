"""Figures of the paper as series of points."""
