"""What a gyroscope reads at rest: its bias, its noise, and the poses that disagree."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from calib.errors import InsufficientMotionError
from calib.fit import Exclusion
from calib.poses import Poses
from calib.recording import Recording
from calib.types import FloatArray


@dataclass(frozen=True, eq=False)
class StaticBias:
    """Mean rate at rest over all poses.

    Parameters
    ----------
    bias : (3,) array, rad/s
    covariance : (3, 3) array
    spread : (3,) array, rad/s
        Standard deviation from pose to pose beyond the noise: drift, temperature, g-sensitivity.
    deviation : (k, 3) array, rad/s
        How far the bias was from the mean at each pose, as far as noise lets one tell.
    excluded : tuple of Exclusion
        Poses whose mean rate is far from the others': the sensor was not at rest.
    """

    bias: FloatArray
    covariance: FloatArray
    spread: FloatArray
    deviation: FloatArray
    excluded: tuple[Exclusion, ...]


def noise_growth(recording: Recording, poses: Poses) -> FloatArray:
    """Return how fast the covariance of the integrated rate grows, (3, 3) rad²/s.

    The median over the poses of ``covariance of the mean x duration``; for white noise of standard
    deviation sigma at interval dt that is ``sigma² dt``.
    """
    count = poses.stop - poses.start
    duration = count * recording.interval
    growth: FloatArray = np.median(poses.gyro_covariance * duration[:, None, None], axis=0)
    # Rounding to a coarse LSB can leave no noise at all at rest.
    lsb = recording.device.gyro_lsb or 0.0
    floor = max(lsb**2 / 12 * recording.interval, 1e-16)
    return growth + floor * np.eye(3)


def static_bias(recording: Recording, poses: Poses) -> StaticBias:
    """Estimate the bias from the poses, with their spread beyond noise in its covariance.

    Per axis ``mean_k = bias + d_k + noise_k``, ``d_k`` of variance ``spread²``, which is estimated
    by moments [1]_. Poses beyond the 1 % family-wise limit of a scale from the median are left out.

    References
    ----------
    .. [1] DerSimonian, Laird, "Meta-analysis in clinical trials", Controlled Clinical Trials 7,
       1986, eq. (8).
    """
    if not len(poses):
        raise InsufficientMotionError(
            "the recording has no static pose, so the gyroscope's bias cannot be read; keep the "
            "sensor at rest for a few seconds before and after each turn"
        )
    duration = (poses.stop - poses.start) * recording.interval
    floor = noise_growth(recording, poses) / duration[:, None, None]
    noise = np.maximum(
        np.diagonal(poses.gyro_covariance, axis1=1, axis2=2),
        0.1 * np.diagonal(floor, axis1=1, axis2=2),
    )
    deviation2 = (poses.gyro - _running_median(poses.gyro)) ** 2
    # 0.455 is the median of chi-square with one degree of freedom.
    scale2 = np.maximum(noise, np.median(deviation2, axis=0) / 0.455)
    good = (deviation2 / scale2).sum(axis=1) <= chdtri(3, 0.01 / len(poses))
    values, weight = poses.gyro[good], 1 / noise[good]
    mean = (weight * values).sum(axis=0) / weight.sum(axis=0)
    heterogeneity = (weight * (values - mean) ** 2).sum(axis=0)
    scale = weight.sum(axis=0) - (weight**2).sum(axis=0) / weight.sum(axis=0)
    excess = heterogeneity - (len(values) - 1)
    spread2 = np.where(scale > 0, np.maximum(excess, 0) / np.where(scale > 0, scale, 1), 0.0)
    weight = 1 / (noise[good] + spread2)
    bias = (weight * values).sum(axis=0) / weight.sum(axis=0)
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
    return StaticBias(bias, np.diag(1 / weight.sum(axis=0)), np.sqrt(spread2), deviation, excluded)


def _running_median(values: FloatArray) -> FloatArray:
    """Return the median over five rows around each of (k, 3) values, fewer at the ends."""
    padded = np.pad(values, ((2, 2), (0, 0)), constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, 5, axis=0)
    median: FloatArray = np.nanmedian(windows, axis=-1)
    return median
