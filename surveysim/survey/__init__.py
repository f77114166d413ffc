"""Many observations: the run over an engine, running sums, checkpoints, and the scores of co-added maps."""
