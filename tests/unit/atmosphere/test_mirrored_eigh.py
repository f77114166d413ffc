"""Eigenvectors of matrices that are their own mirror images, against those of numpy."""

import numpy as np
import pytest

from surveysim.atmosphere.strip_factors import mirrored_eigh


@pytest.mark.parametrize("n", [2, 3, 4, 7, 24, 33])
def test_eigenvectors_of_lanes_at_equal_distances(n):
    lane, density = np.arange(n), np.random.default_rng(n).standard_normal((5, n))
    matrix = density[:, np.abs(lane[:, None] - lane)]
    matrix[0] -= matrix[0].mean(axis=0)  # as for the constant of a strip
    matrix[0] -= matrix[0].mean(axis=1)[:, None]
    value, vector = mirrored_eigh(matrix)
    np.testing.assert_allclose(np.sort(value), np.linalg.eigvalsh(matrix), atol=1e-13 * n)
    np.testing.assert_allclose(vector.transpose(0, 2, 1) @ vector, np.tile(np.eye(n), (5, 1, 1)), atol=1e-13)
    np.testing.assert_allclose(vector * value[:, None] @ vector.transpose(0, 2, 1), matrix, atol=1e-13 * n)
