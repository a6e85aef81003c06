"""What a gyroscope reads at rest: its bias, its noise, and the poses that disagree."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri, fdtri

from calib.errors import InsufficientMotionError
from calib.fit import Exclusion
from calib.poses import Poses
from calib.recording import Recording
from calib.types import FloatArray

BATCH = 0.5
"""s; the noise of the integrated rate is judged from means over this time."""
SIGNIFICANCE = 0.01
"""Chance that noise alone passes for a drift of the bias."""
ALONE = 1.3
"""Variance of a reading less the median of its four neighbours, in units of that of a reading."""


@dataclass(frozen=True, eq=False)
class StaticBias:
    """Mean rate at rest over all poses.

    Parameters
    ----------
    bias : (3,) array, rad/s
    covariance : (3, 3) array
    spread : (3,) array, rad/s
        Standard deviation from pose to pose beyond the noise: drift, temperature, g-sensitivity.
    wander : (3,) array, rad/s
        Standard deviation of the bias at one moment from its mean over the recording: `spread` if
        the poses of all axes together scatter significantly (`SIGNIFICANCE`), else 0.
    deviation : (k, 3) array, rad/s
        How far the bias was from the mean at each pose, as far as noise lets one tell.
    excluded : tuple of Exclusion
        Poses whose mean rate is far from the others': the sensor was not at rest.
    """

    bias: FloatArray
    covariance: FloatArray
    spread: FloatArray
    wander: FloatArray
    deviation: FloatArray
    excluded: tuple[Exclusion, ...]


def noise_growth(recording: Recording, poses: Poses) -> FloatArray:
    """Return how fast the covariance of the integrated rate grows at rest, (3, 3) rad²/s.

    From the differences of means over successive half seconds, which a slow drift does not move and
    in which noise that is correlated from sample to sample counts in full; for white noise of
    standard deviation sigma at interval dt it is ``sigma² dt``. The median over the poses is taken.
    """
    step = recording.interval
    width = max(1, round(BATCH / step)) if step else 1
    growth = []
    for a, b in zip(poses.start, poses.stop, strict=True):
        count = (b - a) // width
        if count < 2:
            continue
        means = recording.gyro[a : a + count * width].reshape(count, width, 3).mean(axis=1)
        square = 0.5 * np.mean(np.diff(means, axis=0) ** 2, axis=0) * width * step
        # Successive differences have two thirds as many degrees of freedom as there are of them;
        # the median of chi-square with v of them is v (1 - 2 / 9v)³ (Wilson and Hilferty).
        growth.append(square / (1 - 1 / (3 * (count - 1))) ** 3)
    lsb = recording.device.gyro_lsb or 0.0
    # Rounding to a coarse LSB can leave no noise at all at rest.
    floor = max(lsb**2 / 12 * step, 1e-16)
    typical = np.median(growth, axis=0) if growth else np.zeros(3)
    return np.diag(np.maximum(typical, floor))


def static_bias(recording: Recording, poses: Poses) -> StaticBias:
    """Estimate the bias from the poses, with their spread beyond noise in its covariance.

    Per axis ``mean_k = bias + d_k + noise_k``, ``d_k`` of variance ``spread²``, which is estimated
    by moments [1]_. Poses beyond the 1 % family-wise limit of a scale from the median are left out.

    References
    ----------
    .. [1] DerSimonian, Laird, "Meta-analysis in clinical trials", Controlled Clinical Trials 7,
       1986, eq. (8).
    .. [2] Bayley, Hammersley, "The effective number of independent observations in an
       autocorrelated time series", J. Royal Stat. Soc. Suppl. 8(2), 1946.
    """
    if not len(poses):
        raise InsufficientMotionError(
            "the recording has no static pose, so the gyroscope's bias cannot be read; keep the "
            "sensor at rest for a few seconds before and after each turn"
        )
    duration = (poses.stop - poses.start) * recording.interval
    floor = np.diag(noise_growth(recording, poses)) / duration[:, None]
    noise = np.maximum(np.diagonal(poses.gyro_covariance, axis1=1, axis2=2), 0.1 * floor)
    deviation2 = (poses.gyro - _neighbours(poses.gyro)) ** 2
    # 0.455 is the median of chi-square with one degree of freedom.
    scale2 = np.maximum(ALONE * noise, np.median(deviation2, axis=0) / 0.455)
    distance = (deviation2 / scale2).sum(axis=1) / 3
    good = distance <= fdtri(3, max(len(poses) - 1, 1), 1 - 0.01 / len(poses))
    values, weight = poses.gyro[good], 1 / noise[good]
    mean = (weight * values).sum(axis=0) / weight.sum(axis=0)
    heterogeneity = (weight * (values - mean) ** 2).sum(axis=0)
    scale = weight.sum(axis=0) - (weight**2).sum(axis=0) / weight.sum(axis=0)
    excess = heterogeneity - (len(values) - 1)
    drifts = heterogeneity.sum() > chdtri(3 * max(len(values) - 1, 1), SIGNIFICANCE)
    spread2 = np.where(scale > 0, np.maximum(excess, 0) / np.where(scale > 0, scale, 1), 0.0)
    weight = 1 / (noise[good] + spread2)
    bias = (weight * values).sum(axis=0) / weight.sum(axis=0)
    variance = 1 / weight.sum(axis=0) + spread2 * _correlation_excess(values - bias) / len(values)
    # The best guess of d_k shrinks towards 0 by the share of noise in it; between poses, and over
    # those left out, it is interpolated.
    shrunk = spread2 / np.maximum(spread2 + noise, 1e-30) * (poses.gyro - bias)
    middle = poses.interval.mean(axis=1)
    deviation = np.stack([np.interp(middle, middle[good], d[good]) for d in shrunk.T], axis=1)
    excluded = tuple(
        Exclusion(
            (float(poses.interval[k, 0]), float(poses.interval[k, 1])),
            0.0,
            "the gyroscope's mean is far from the poses around: the sensor was not at rest",
        )
        for k in np.flatnonzero(~good)
    )
    spread = np.sqrt(spread2)
    return StaticBias(bias, np.diag(variance), spread, spread * drifts, deviation, excluded)


def _correlation_excess(deviation: FloatArray) -> FloatArray:
    """Return ``(1 + r) / (1 - r) - 1`` per axis, 0 where neighbours are not clearly alike."""
    k = len(deviation)
    if k < 5:
        return np.zeros(3)
    power = np.maximum((deviation**2).sum(axis=0), 1e-300)
    r = (deviation[1:] * deviation[:-1]).sum(axis=0) / power
    r = np.where(r > 2 / np.sqrt(k), np.clip(r, 0, 1 - 2 / k), 0.0)
    excess: FloatArray = (1 + r) / (1 - r) - 1
    return excess


def _neighbours(values: FloatArray) -> FloatArray:
    """Return the median of the two rows before and after each of (k, 3) values, fewer at the ends.

    A single row is its own neighbour.
    """
    if len(values) < 2:
        return values
    padded = np.pad(values, ((2, 2), (0, 0)), constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, 5, axis=0)
    median: FloatArray = np.nanmedian(windows[..., [0, 1, 3, 4]], axis=-1)
    return median
