"""What comes in whole numbers: samples that were lost, or that came again."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.calibration import Quantity
from calib.mismatch.rows.rows import Rows
from calib.mismatch.search.accepted import Accepted, contrast_noise
from calib.mismatch.search.estimate import solved
from calib.types import FloatArray

UNCLEAR = 0.3
"""Standard error of a count of samples above which it is not known to be whole."""

CERTAIN = 1e-3
"""The same where it is known which: the probability of any other is less than a millionth."""


def is_whole(q: Quantity) -> bool:
    """Whether a count is a whole number other than zero, and not any other."""
    near, sigma = round(q.value), q.sigma or 0.0
    return near != 0 and sigma < UNCLEAR and abs(q.value - near) < 4.0 * sigma + 0.05


def counted(q: Quantity) -> Quantity:
    """Return a count of samples as the most probable whole number, and how uncertain that is.

    Its standard error is that of the whole numbers about it; None where no other is likely.
    """
    whole = round(q.value) + np.arange(-2, 3)
    square = np.square((whole - q.value) / max(q.sigma or 0.0, 1e-9))
    weight = np.exp(-0.5 * (square - square.min()))
    value = whole[int(np.argmax(weight))]
    sigma = float(np.sqrt(weight @ np.square(whole - value) / weight.sum()))
    return Quantity(float(value), sigma if sigma > CERTAIN else None, q.unit)


def parts_of_samples(
    rows: Rows, accepted: Sequence[Accepted], levels: FloatArray
) -> list[Accepted]:
    """Return the losses of samples that are not of whole ones: those have another cause."""
    out: list[Accepted] = []
    if not any(a.candidate.counted for a in accepted):
        return out
    step, covariance, _ = solved(rows, tuple(accepted), levels, contrast_noise(rows, accepted))
    at = rows.baseline.shape[1] + rows.nuisance.shape[1]
    for a in accepted:
        own = slice(at, at + a.columns.shape[1])
        at = own.stop
        values = a.values + step[own] * a.typical
        sigma = np.sqrt(np.diag(covariance)[own]) * a.typical
        count = (
            Quantity(float(v), float(s), "samples") for v, s in zip(values, sigma, strict=True)
        )
        if a.candidate.counted and not all(map(is_whole, count)):
            out.append(a)
    return out
