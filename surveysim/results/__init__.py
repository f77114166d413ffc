"""Results of a run: score table, control variate, stopping rule, closure test, forecast."""
