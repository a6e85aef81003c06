"""One robust step of what is fitted to the rows of a comparison."""

from __future__ import annotations

import numpy as np

from calib.mismatch.rows.rows import Rows
from calib.mismatch.search.joint import scaled
from calib.types import FloatArray


def robust_step(
    rows: Rows, beside: FloatArray, prior: FloatArray
) -> tuple[FloatArray, FloatArray, float]:
    """Return the Gauss-Newton steps of baseline and nuisances, and of others, by Huber's weights.

    Beside them the most by which they move a row, in standard deviations.

    Parameters
    ----------
    rows : Rows
    beside : (m, k) array
        The columns of k others.
    prior : (k, 2) array
        Where these are, and how far that may be off.
    """
    sigma = np.sqrt(np.concatenate((rows.expected_variance(), rows.white_diagonal)))
    design = np.hstack((rows.baseline, rows.nuisance, beside)) / sigma[:, None]
    y = rows.residual / sigma
    at, loose = np.vstack((rows.prior, prior)).T
    ridge, pull = np.diag(1.0 / loose), -at / loose
    weight = np.ones(len(y))
    step = np.zeros(design.shape[1])
    for _ in range(5):
        root = np.sqrt(weight)
        stacked, size = scaled(np.vstack((design * root[:, None], ridge)))
        step = np.linalg.lstsq(stacked, np.append(y * root, pull), rcond=1e-12)[0] / size
        left = np.abs(y - design @ step)
        scale = max(float(np.median(left)) / 0.6745, 1.0)
        weight = np.minimum(1.0, 3.0 * scale / np.maximum(left, 1e-12)) / scale**2
    own = len(rows.prior)
    return step[:own], step[own:], float(np.abs(design @ step).max())
