"""What every solver returns."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from calib.model import Triad
from calib.types import FloatArray


@dataclass(frozen=True)
class Exclusion:
    """A pose or segment that was left out or down-weighted.

    ``weight`` is 0 where it was left out; ``interval`` is in recording seconds.
    """

    interval: tuple[float, float]
    weight: float
    reason: str


@dataclass(frozen=True, eq=False)
class Fit:
    """The result of a solver: parameters with covariance, residuals, and what is not determined.

    Parameters
    ----------
    method : str
        The solver's name.
    triad : Triad
        Bias, scale factor error and misalignment; parameters that are not determined hold their
        prior value (0).
    names : tuple of str
        Of the p parameters, as the convention page names them (``accel.bias.x``).
    values : (p,) array
    units : tuple of str
    covariance : (p, p) array
        NaN in rows and columns of what is not determined.
    residuals : (m, k) array
        One row per pose or segment, in ``residual_unit``.
    residual_unit : str
    intervals : (m, 2) array, s
        Where each residual row was measured, in recording seconds.
    degrees_of_freedom : int
    condition_number : float
        Of the scaled (unit column) design matrix.
    undetermined : tuple of str
        Names of the parameters that the data does not determine.
    advice : tuple of str
        For each reason why something is undetermined: what to record.
    excluded : tuple of Exclusion
    accel_sensitivity : (p, 12) array, optional
        Of a gyroscope: derivative of its values to the accelerometer's parameters, in the order of
        `Triad.parameters`. ``covariance`` is that with the accelerometer as given; its errors add
        ``D C D'``.
    """

    method: str
    triad: Triad
    names: tuple[str, ...]
    values: FloatArray
    units: tuple[str, ...]
    covariance: FloatArray
    residuals: FloatArray
    residual_unit: str
    intervals: FloatArray
    degrees_of_freedom: int
    condition_number: float
    undetermined: tuple[str, ...] = ()
    advice: tuple[str, ...] = ()
    excluded: tuple[Exclusion, ...] = field(default=())
    accel_sensitivity: FloatArray | None = None

    @property
    def standard_errors(self) -> FloatArray:
        """Square roots of the covariance's diagonal, (p,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def residual_rms(self) -> float:
        """Root mean square of the residuals, in ``residual_unit``."""
        return float(np.sqrt(np.mean(self.residuals**2)))
