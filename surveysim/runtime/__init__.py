"""Infrastructure: engines, random numbers, errors, provenance, text from outside.

`engine` maps a job over observations: in this process, in worker processes or on a dask cluster. `rng` makes random
generators keyed by seed, purpose, realization and observation. `errors` defines the errors that input explains. The
other modules read and write text safely.
"""
