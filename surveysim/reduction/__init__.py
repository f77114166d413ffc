"""The reduction of one observation: cleaning, maps of every data set, noise levels, the best cleaning."""
