"""Iteration over rows of large arrays in chunks."""

from collections.abc import Iterator

# Samples in a chunk of independent detectors: chunk and results fit in a processor's cache, and memory does not grow
# with the number of detectors.
CHUNK_SAMPLES = 2**18


def row_chunks(n_row: int, row_samples: int) -> Iterator[slice]:
    """Slices of rows of `row_samples` samples, with `CHUNK_SAMPLES` samples or one row each."""
    step = max(1, CHUNK_SAMPLES // row_samples)
    return (slice(first, min(first + step, n_row)) for first in range(0, n_row, step))
