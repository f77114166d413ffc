"""The machinery around the science: engines, random numbers, processes, provenance.

`engine` maps a job over observations, in this process, in worker processes or on a dask cluster. `rng` gives random
generators keyed by seed, purpose, realization and observation. The rest reads and writes text safely.
"""
