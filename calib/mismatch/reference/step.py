"""One robust step of what is fitted to the rows of a comparison."""

from __future__ import annotations

import numpy as np

from calib.mismatch.rows.rows import Rows
from calib.mismatch.search.joint import scaled
from calib.types import FloatArray


def robust_step(rows: Rows) -> tuple[FloatArray, float]:
    """Return the Gauss-Newton step of baseline and nuisances, by Huber's weights.

    Beside it the most by which it moves a row, in standard deviations.
    """
    sigma = np.sqrt(np.concatenate((rows.expected_variance(), rows.white_diagonal)))
    design = np.hstack((rows.baseline, rows.nuisance)) / sigma[:, None]
    y = rows.residual / sigma
    ridge = np.diag(1.0 / rows.prior[:, 1])
    pull = -rows.prior[:, 0] / rows.prior[:, 1]
    weight = np.ones(len(y))
    step = np.zeros(design.shape[1])
    for _ in range(5):
        root = np.sqrt(weight)
        stacked, size = scaled(np.vstack((design * root[:, None], ridge)))
        step = np.linalg.lstsq(stacked, np.append(y * root, pull), rcond=1e-12)[0] / size
        left = np.abs(y - design @ step)
        scale = max(float(np.median(left)) / 0.6745, 1.0)
        weight = np.minimum(1.0, 3.0 * scale / np.maximum(left, 1e-12)) / scale**2
    return np.asarray(step), float(np.abs(design @ step).max())
