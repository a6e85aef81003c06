"""Whether an accelerometer has other axes than what it is compared with, and how far it is turned.

Its three angles of non-orthogonality are those of a frame of its own: x along its x axis, y in the
plane of its x and y. A simulation's frame may be another (y axis, and the plane of y and z; or the
body's), and its gyroscope's may be that. Then the accelerometer is turned against it as well.

What else a bias may do (follow temperature, warm up, step, settle) goes with the direction of
gravity too where poses are visited in order. So the angles are asked of what turns show while they
last, whatever the bias of each window is, and those of one half of the windows must hold in the
other.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import chdtrc

from calib.effects import get_effect
from calib.mismatch.noise.noise import Whitener, expected_levels, make_whitener
from calib.mismatch.reference.carried import OF_GYRO
from calib.mismatch.reference.setup import ACCEL_ANGLES
from calib.mismatch.rows.rows import Kind, Rows
from calib.mismatch.search.accepted import contrast_noise, fitted
from calib.mismatch.search.refine import likelihood_gain
from calib.mismatch.twin.twin import baseline_column
from calib.recording import AXES
from calib.types import BoolArray, FloatArray

CLEARLY = 10.0
"""Log-likelihood that turning the accelerometer gains at least, and turning both triads does not:
what is concealed from a simulation in the sensor's own frame gains less by it."""

BY_CHANCE = 0.01
"""Probability that the other one's errors alone turn it as far, above which they may have."""

UPPER = tuple(np.transpose([[AXES.index(a) for a in name[-2:]] for name in ACCEL_ANGLES]))
"""Where the angles are in a matrix."""


def has_own_axes(rows: Rows) -> bool:
    """Return whether rows beside a simulation show an accelerometer that is turned, and it alone.

    Both triads are where the sensor is mounted at an angle: that is a finding.
    """
    return _gain(_of_any_bias(rows)) > CLEARLY


def has_the_others(rows: Rows, errors: FloatArray, spread: FloatArray) -> bool:
    """Return whether the accelerometer is turned as the errors of another IMU may turn it.

    Where two are mounted at an angle the scale factors of the other's accelerometer have an upper
    triangle in the sensor's frame. What is more than those errors can be is the sensor's own, and
    left to be found. So is it where the gyroscopes differ by more than a rotation: their axes take
    it up.

    Parameters
    ----------
    rows : Rows
    errors, spread : (18,) arrays
        Of the other IMU in the sensor's frame, and how far they may be off
        (`calib.mismatch.reference.carried.known_errors`): its gyroscope's axes are turned against
        its accelerometer's by the odd part of E.
    """
    rows = _of_any_bias(rows)
    if _gain(rows) <= CLEARLY:
        return False
    whitener = _whitener(rows)
    y, columns = whitener.project(rows.residual), _turning(rows, whitener)
    effect = get_effect("gyro_misalignment").columns(rows.state, {}).values()
    axes = whitener.project(np.stack([rows.column(c) for c in effect], axis=1))
    if likelihood_gain(np.hstack((columns, axes)), y) - likelihood_gain(columns, y) > CLEARLY:
        return False
    covariance = np.linalg.pinv(columns.T @ columns)
    matrix, loose = (x[3:OF_GYRO].reshape(3, 3) for x in (errors, spread))
    odd, either = 0.5 * (matrix - matrix.T), 0.25 * (np.square(loose) + np.square(loose.T))
    off = covariance @ (columns.T @ y) - odd[UPPER]
    total = float(off @ np.linalg.solve(covariance + np.diag(either[UPPER]), off))
    return bool(chdtrc(len(off), total) > BY_CHANCE)


def _gain(rows: Rows) -> float:
    """Return the log-likelihood that turning the accelerometer gains, and both triads do not."""
    whitener = _whitener(rows)
    y = whitener.project(rows.residual)
    alone = _turning(rows, whitener)
    both = get_effect("reference_misalignment").columns(rows.state, {}).values()
    turned = whitener.project(np.stack([rows.column(c) for c in both], axis=1))
    first = rows.segment % 2 == 0
    gain = _foretold(alone, y, first) + _foretold(alone, y, ~first)
    return gain - max(likelihood_gain(turned, y), 0.0)


def _of_any_bias(rows: Rows) -> Rows:
    """Return rows without the means of windows of the accelerometer, which its bias is in."""
    means = (rows.kind == int(Kind.MEAN)) & (rows.channel < 3)
    left = rows.without(means)
    return replace(left, components=tuple(c for c in left.components if len(c.index)))


def _whitener(rows: Rows) -> Whitener:
    return make_whitener(rows, expected_levels(rows), contrast_noise(rows, []), fitted(rows, []))


def _turning(rows: Rows, whitener: Whitener) -> FloatArray:
    """Return what a unit of each of `ACCEL_ANGLES` adds to the whitened rows, (m, 3)."""
    columns = [rows.column(baseline_column(name, rows.state)) for name in ACCEL_ANGLES]
    return whitener.project(np.stack(columns, axis=1))


def _foretold(columns: FloatArray, y: FloatArray, told: BoolArray) -> float:
    """Return the log-likelihood that whitened columns gain where they were not fitted.

    They are fitted to the rows that are ``told``, (m,) bool.
    """
    values = np.linalg.lstsq(columns[told], y[told], rcond=1e-9)[0]
    step = columns[~told] @ values
    return float(step @ y[~told] - 0.5 * step @ step)
