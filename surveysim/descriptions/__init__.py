"""Scenes from descriptions of cameras that other programs read."""
