"""Linear algebra of the bench against the plain formulas, hypothesis by hypothesis."""

import numpy as np
import pytest
from scipy.stats import chi2, f

from galen_hw.diagnosis.stats.linear_algebra import log_tail, quadratic


def test_many_hypotheses_at_once_are_each_the_quadratic_form_of_its_own() -> None:
    """R' A^-1 r with full rank; a direction that the model already holds is left out and not counted."""
    rng = np.random.default_rng(0)
    X = rng.normal(size=(20, 50, 3))
    X[7, :, 2] = X[7, :, 0] - 2.0 * X[7, :, 1]
    X[9] = 0.0
    y, surrogates = rng.normal(size=50), rng.normal(size=(50, 4))
    A = np.swapaxes(X, 1, 2) @ X
    squares = np.diagonal(A, axis1=1, axis2=2)
    gains, fakes, counts = quadratic(A, squares, np.swapaxes(X, 1, 2) @ y, np.swapaxes(X, 1, 2) @ surrogates)
    assert counts.tolist() == [2 if m == 7 else 0 if m == 9 else 3 for m in range(20)]
    for m in range(20):
        basis = np.linalg.svd(X[m], full_matrices=False)[0][:, : counts[m]]
        assert gains[m] == pytest.approx(np.sum((basis.T @ y) ** 2), rel=1e-9)
        assert fakes[m] == pytest.approx(np.sum((basis.T @ surrogates) ** 2, axis=0), rel=1e-9)


@pytest.mark.parametrize("degrees", [30.0, 900.0, 1e6])
def test_tails_are_those_of_f_and_chi_square_far_beyond_what_a_double_holds(degrees) -> None:
    """Of several counts at once; monotone where the plain tail is zero already."""
    counts, gains = np.array([1, 2, 5])[:, None], np.array([0.0, 3.0, 40.0, 400.0])
    law = chi2.logsf(gains, counts) if degrees > 4000 else f.logsf(gains / counts, counts, degrees)
    assert log_tail(gains, counts, degrees) == pytest.approx(law, rel=1e-3, abs=1e-9)
    far = log_tail(np.array([1e4, 2e4, 4e4]), np.array([2]), degrees)
    assert np.all(np.isfinite(far))
    assert np.all(np.diff(far) < 0.0)
