"""Comparison of finished runs: settings that differ, and scores with paired errors where random numbers are common."""
