"""Search for the best design: knobs of a scene, forecasts, a descent, and how flat the optimum is."""
