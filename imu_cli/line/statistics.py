"""What a history says about a process: yield, Cpk, outliers, and stations that wander."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from calib.types import FloatArray

MAD_TO_SIGMA = 1.4826
"""1 / Phi^-1(3/4): scales the median absolute deviation to a normal's standard deviation."""

MAD_EFFICIENCY = 0.37
"""Of the median absolute deviation at a normal: Huber, Robust Statistics, 1981, section 5.1."""


@dataclass(frozen=True)
class Capability:
    """How well a parameter sits within its limits.

    ``cpk = min(high - mean, mean - low) / (3 s)`` with s the sample standard deviation; None with
    fewer than two units, no limit, or no spread. The interval is the approximate 95 % confidence
    interval after Bissell.

    References
    ----------
    .. [1] A. F. Bissell, "How Reliable is Your Capability Index?", Applied Statistics 39(3), 1990.
    """

    name: str
    unit: str
    count: int
    mean: float
    deviation: float
    cpk: float | None
    cpk_interval: tuple[float, float] | None


def capability(
    name: str, values: FloatArray, *, unit: str, low: float | None, high: float | None
) -> Capability:
    """Return the process capability of one parameter over units."""
    count = len(values)
    mean = float(np.mean(values))
    deviation = float(np.std(values, ddof=1)) if count > 1 else 0.0
    margins = [] if low is None else [mean - low]
    margins += [] if high is None else [high - mean]
    if not margins or deviation == 0.0:
        return Capability(name, unit, count, mean, deviation, None, None)
    cpk = min(margins) / (3 * deviation)
    half = 1.96 * np.sqrt(1 / (9 * count) + cpk**2 / (2 * (count - 1)))
    return Capability(name, unit, count, mean, deviation, cpk, (cpk - half, cpk + half))


@dataclass(frozen=True)
class Outlier:
    """A unit whose value lies far from the others': ``score`` in robust standard deviations."""

    serial_number: str
    name: str
    value: float
    score: float
    p_value: float


def outliers(
    serial_numbers: Sequence[str],
    values: Mapping[str, FloatArray],
    *,
    family_error: float = 0.01,
    minimum: int = 8,
) -> list[Outlier]:
    """Return units that are outliers in any parameter, the chance of one false one held in all.

    The score is against the median in units of the median absolute deviation, tested two-sided by
    Student's t, Bonferroni-corrected over units and parameters. The median absolute deviation has
    37 % of the sample deviation's efficiency, so its degrees of freedom are 0.37 (n - 1).
    """
    tests = sum(len(column) for column in values.values())
    found = []
    for name, column in values.items():
        if len(column) < minimum:
            continue
        centre = np.median(column)
        spread = MAD_TO_SIGMA * np.median(np.abs(column - centre))
        if spread == 0:
            continue
        scores = (column - centre) / spread
        p_values = np.minimum(
            1.0, tests * 2 * stats.t.sf(np.abs(scores), MAD_EFFICIENCY * (len(column) - 1))
        )
        found += [
            Outlier(serial_numbers[k], name, float(column[k]), float(scores[k]), float(p_values[k]))
            for k in np.flatnonzero(p_values < family_error).tolist()
        ]
    return sorted(found, key=lambda item: item.p_value)


@dataclass(frozen=True)
class Drift:
    """A parameter that wanders with time at one station: Kendall's tau against order."""

    station: str
    name: str
    tau: float
    slope_per_day: float
    p_value: float


def drifts(
    station: str,
    days: FloatArray,
    values: Mapping[str, FloatArray],
    *,
    family_error: float = 0.01,
    minimum: int = 8,
) -> list[Drift]:
    """Return parameters with a monotonic trend in time, p-values corrected for their number.

    A trend over units that differ by chance is no trend: Kendall's rank test needs no distribution.
    The slope is Theil and Sen's median slope.
    """
    found = []
    for name, column in values.items():
        if len(column) < minimum or np.ptp(column) == 0 or np.ptp(days) == 0:
            continue
        tau, p_value = stats.kendalltau(days, column)
        p_value = min(1.0, float(p_value) * len(values))
        if p_value < family_error:
            slope = float(stats.theilslopes(column, days).slope)
            found.append(Drift(station, name, float(tau), slope, p_value))
    return sorted(found, key=lambda item: item.p_value)
