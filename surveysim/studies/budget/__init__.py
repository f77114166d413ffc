"""Budget of a scene: the cost of each of its stages, from the scene with and without it."""
