"""Uncertainty budget of a calibration, in the sense of the GUM.

Type A is what the fit's covariance says. Type B are contributions that no repetition shows:

- **gravity**: a relative error of the assumed g is the same relative error of all three
  accelerometer scale factors, ``u(g) / g``;
- **temperature**: the calibration holds over the temperatures of its poses; used anywhere in that
  span, a bias with a typical temperature coefficient c moves by c times the half-width,
  rectangular: ``c dT / sqrt(3)``. Not where the model has the temperature term itself;
- **alignment**: how well the housing's frame is known, ``u(angle)``, in the misalignments.

The combined standard uncertainty is the root of the sum of squares; the expanded one is k = 2 times
that, about 95 %.

References
----------
.. [1] JCGM 100:2008 (GUM), sections 4.2 (type A), 4.3 (type B, rectangular in 4.3.7), 5.1, 6.2.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from calib.calibration import Calibration, parameter_unit
from calib.effects import effects

COVERAGE = 2.0
UNKNOWN_TEMPERATURE_HALF_WIDTH = 5.0
"""K, assumed where no temperature was recorded: a room's span over a day."""


@dataclass(frozen=True)
class Budget:
    """The uncertainty of one parameter, in its unit.

    ``type_a`` is the standard error of the fit, ``type_b`` each other contribution by name,
    ``combined`` the standard uncertainty and ``expanded`` twice that.
    """

    name: str
    value: float
    unit: str
    type_a: float
    type_b: Mapping[str, float]

    @property
    def combined(self) -> float:
        """Root of the sum of squares of all contributions."""
        return float(np.sqrt(self.type_a**2 + sum(u**2 for u in self.type_b.values())))

    @property
    def expanded(self) -> float:
        """``k = 2`` times the combined standard uncertainty."""
        return COVERAGE * self.combined


def uncertainty_budget(calibration: Calibration) -> list[Budget]:
    """Return the budget of every determined parameter, in the calibration's order."""
    values, sigmas = calibration.values, calibration.sigmas
    return [
        Budget(name, values[name], parameter_unit(name), sigmas[name], _type_b(calibration, name))
        for name in calibration.names
    ]


def half_width(calibration: Calibration) -> float:
    """Return half the temperature span that the calibration is used over, K."""
    span = calibration.temperature
    if span is None:
        return UNKNOWN_TEMPERATURE_HALF_WIDTH
    return max((span.high - span.low) / 2, 0.5)


def _type_b(calibration: Calibration, name: str) -> dict[str, float]:
    out: dict[str, float] = {}
    group = name.rpartition(".")[0]
    gravity = calibration.gravity
    if group == "accel.scale_factor_error" and gravity.sigma > 0:
        out["gravity"] = gravity.sigma / gravity.value
    tempco = {
        "accel.bias": "accel_bias_temperature",
        "gyro.bias": "gyro_bias_temperature",
        "accel.scale_factor_error": "accel_scale_temperature",
        "gyro.scale_factor_error": "gyro_scale_temperature",
    }.get(group)
    if tempco is not None and all(term.effect != tempco for term in calibration.model.terms):
        coefficient = effects()[tempco].parameters[0].typical
        out["temperature"] = coefficient * half_width(calibration) / np.sqrt(3)
    if group.endswith("misalignment") and calibration.housing is not None:
        out["alignment"] = float(np.max(calibration.housing.sigma))
    return out
