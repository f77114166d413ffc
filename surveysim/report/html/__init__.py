"""HTML pages of runs, sweeps, convergence studies and the paper's items."""
