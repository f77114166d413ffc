"""Studies made of many runs: sweeps, convergence of numerical settings, stress cases, and the resources of a run."""
