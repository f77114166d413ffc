"""Cleaning, map-making and map spectra for bolometer arrays: arrays in, arrays out.

Knows detector positions, time-streams and maps, and nothing of scenes, weather or random numbers.
"""
