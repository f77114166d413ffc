"""Sweeps: axes of values, points run or forecast, and their comparison with paired errors."""
