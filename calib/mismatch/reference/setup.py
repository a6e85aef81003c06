"""Where a comparison stands: a sensor's model, the alignment in time, frames; how far they move."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from calib.effects.base import Term
from calib.mismatch.reference.alignment import Alignment
from calib.mismatch.twin.twin import ACCEL_MISALIGNMENT, GYRO_MISALIGNMENT
from calib.mismatch.twin.twinfit import PART
from calib.model import SensorModel
from calib.recording import AXES
from calib.rotation import mat_from_rotvec
from calib.types import FloatArray

BASELINE = (
    *(f"accel.bias.{a}" for a in AXES),
    *(f"accel.scale_factor_error.{a}" for a in AXES),
    *(f"accel.misalignment.{p}" for p in ACCEL_MISALIGNMENT),
    *(f"gyro.bias.{a}" for a in AXES),
    *(f"gyro.scale_factor_error.{a}" for a in AXES),
)
ACCEL_ANGLES = tuple(f"accel.misalignment.{p[::-1]}" for p in ACCEL_MISALIGNMENT)
"""What turns an accelerometer against the frame of the truth."""

GYRO_ANGLES = tuple(f"gyro.misalignment.{p}" for p in GYRO_MISALIGNMENT)
GYRO_TERM = tuple(f"gyro_misalignment.m{p}" for p in GYRO_MISALIGNMENT)
"""The same, as a term has them."""

LOOSE = {
    "bias": 2.0,
    "scale_factor_error": PART,
    "misalignment": PART,
    "delay": 0.1,
    "scale": 0.01,
    **dict.fromkeys(("rx", "ry", "rz"), 0.2),
}
"""How far (SI) baseline and alignment may be from where they start.

Some more than data sheets say (MPU-6050 product specification rev. 3.4: 80 mg, 20 dps; `PART`), and
of the alignment what the correlation of rates and Wahba's problem leave open. What the motion does
not determine (the heading of a sensor on a table that turns about the vertical) stays there.
"""


class Setup(NamedTuple):
    """Where the comparison stands: sensor model, alignment in time, frames."""

    model: SensorModel
    alignment: Alignment
    mat_sr: FloatArray
    errors: FloatArray
    """Of another IMU, as an arm carries them."""

    def moved(
        self,
        baseline: Mapping[str, float],
        nuisance: FloatArray,
        terms: tuple[Term, ...],
        *,
        turned: bool,
    ) -> Setup:
        """Return the setup with its parameters moved by steps, and with these further terms.

        Nuisances are the delay and the scale of the clock, the angles of the frame if that may be
        ``turned``, and the errors of another IMU.
        """
        triads = []
        for name, triad in (("accel", self.model.accel), ("gyro", self.model.gyro)):
            now = triad.parameters(name)
            triads.append(
                triad.with_parameters({k: now[k] + v for k, v in baseline.items() if k in now})
            )
        model = replace(self.model, accel=triads[0], gyro=triads[1], terms=terms)
        alignment = self.alignment.moved(-float(nuisance[0]), -float(nuisance[1]))
        own = 5 if turned else 2
        # f x rho is -skew(rho) f: the frame turned by -rho.
        mat = mat_from_rotvec(-np.asarray(nuisance[2:5])) @ self.mat_sr if turned else self.mat_sr
        errors = self.errors + nuisance[own:] if len(nuisance) > own else self.errors
        return Setup(model, alignment, mat, errors)
