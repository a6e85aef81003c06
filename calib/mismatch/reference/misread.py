"""What a gyroscope reads of the turns that a truth has: other axes, another sign, a factor.

Gravity says how the sensor is mounted, but for a turn about the vertical where it was along one
axis alone. Turned by that, the truth's rates are what the gyroscope should read; a scale factor of
-1, or of 2, would take up what it reads instead. A walk has few rests, and its own turns do not
tell.
"""

from __future__ import annotations

import numpy as np

from calib.errors import NoCommonMotionError
from calib.mismatch.findings.diagnosis import Finding
from calib.mismatch.noise.hush import audible
from calib.mismatch.reference.alignment import Alignment
from calib.mismatch.reference.laid import reading
from calib.mismatch.reference.mounted import both
from calib.mismatch.reference.truths import RecordingTruth
from calib.mismatch.samples.units import axes_beside, factor_beside, look_at_units
from calib.recording import Recording
from calib.rotation import nearest_rotation
from calib.statics import find_poses

TOLD = 0.05
"""Second singular value of gravity's directions, relative to the first, from which they tell a
mounting: of poses that are 13 degrees apart."""

FACTOR, MOST = 1.3, 2000.0
"""Times that a scale is another unit's, or range's: no sensor is off by as much; and at most, as
thousandths are."""


class MisreadError(NoCommonMotionError):
    """A truth that shows the recording's motion on other axes, or in another unit."""

    def __init__(self, finding: Finding) -> None:
        super().__init__(finding.sentence)
        self.finding = finding


def misread(
    real: Recording, truth: RecordingTruth, alignment: Alignment, *, other: str
) -> Finding | None:
    """Return the finding that a triad reads something else than the `other` has, if it does."""
    (gyro, rate), (accel, force) = both(real, truth, alignment)
    if not (len(rate) and all(v.any() for v in (gyro, rate, accel, force))):
        return None
    product = accel.T @ force
    size = np.linalg.svd(product, compute_uv=False)
    if size[1] > TOLD * size[0]:
        mat, about = nearest_rotation(product), None
    else:
        about = accel.mean(axis=0) / max(float(np.linalg.norm(accel.mean(axis=0))), 1e-12)
        mat = nearest_rotation(np.outer(about, force.mean(axis=0)))
    number, factor = reading(gyro, rate @ mat.T, about)
    if number:
        return axes_beside(real, {"gyro": number}, other=other)
    if _is_other_unit(factor):
        return _off(real, truth, "gyro", factor, other=other)
    number, factor = reading(accel, force @ mat.T, about)
    if not number and _is_other_unit(factor):
        return _off(real, truth, "accel", factor, other=other)
    return None


def _off(
    real: Recording, truth: RecordingTruth, triad: str, factor: float, *, other: str
) -> Finding:
    """Return the finding of another unit, with whose it is, if the other shows that by itself."""
    found, _ = look_at_units(truth.recording, find_poses(audible(truth.recording)))
    theirs = any(
        item.effect == "unit_error" and item.channels[0].startswith(triad) for item in found
    )
    return factor_beside(real, triad, factor, other=other, theirs=theirs)


def _is_other_unit(factor: float) -> bool:
    return FACTOR < factor < MOST or FACTOR < 1.0 / max(factor, 1e-12) < MOST
