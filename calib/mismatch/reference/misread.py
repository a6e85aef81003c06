"""What a gyroscope reads of the turns that a truth has: other axes, another sign, a factor.

Gravity says how the sensor is mounted, but for a turn about the vertical where it was along one
axis alone. Turned by that, the truth's rates are what the gyroscope should read; a scale factor of
-1, or of 2, would take up what it reads instead. A walk has few rests, and its own turns do not
tell.
"""

from __future__ import annotations

import numpy as np

from calib.effects.axis_error import ORDERS, signed_permutation
from calib.errors import NoCommonMotionError
from calib.mismatch.findings.diagnosis import Finding
from calib.mismatch.reference.alignment import Alignment
from calib.mismatch.reference.laid import TIED
from calib.mismatch.reference.mounted import UNLIKE, both
from calib.mismatch.reference.truths import RecordingTruth
from calib.mismatch.samples.samples import axes_beside, factor_beside
from calib.recording import Recording
from calib.rotation import nearest_rotation, skew
from calib.types import FloatArray

TOLD = 0.05
"""Second singular value of gravity's directions, relative to the first, from which they tell a
mounting: of poses that are 13 degrees apart."""

ALIKE = 0.05
"""Share of the rates' power that the right reading leaves at most."""

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
    number, factor = _reading(gyro, rate @ mat.T, about)
    if number:
        return axes_beside(real, {"gyro": number}, other=other)
    if _is_other_unit(factor):
        return factor_beside(real, "gyro", factor, other=other)
    number, factor = _reading(accel, force @ mat.T, about)
    if not number and _is_other_unit(factor):
        return factor_beside(real, "accel", factor, other=other)
    return None


def _is_other_unit(factor: float) -> bool:
    return FACTOR < factor < MOST or FACTOR < 1.0 / max(factor, 1e-12) < MOST


def _reading(seen: FloatArray, true: FloatArray, about: FloatArray | None) -> tuple[int, float]:
    """Return in which of the `ORDERS` a triad reads (n, 3) vectors, and how many times as large.

    These may be turned by any angle about an axis, (3,), if one is given: ``R(t) = cos(t) (I - u
    u') + sin(t) [u]x + u u'``, so that any trace is ``a cos(t) + b sin(t) + c``, and at most
    ``|(a, b)| + c``. The factor is 0 where no way explains what it reads.
    """
    power, own = float(np.square(true).sum()), float(np.square(seen).sum())
    ways = np.stack([signed_permutation(k) for k in range(len(ORDERS))])
    cross = np.einsum("kji,jl->kil", ways, seen.T @ true)  # P' C
    along = np.einsum("kii->k", cross)
    if about is not None:
        # tr(R' C) = C : R.
        c = np.einsum("i,kij,j->k", about, cross, about)
        turn = np.einsum("kij,ij->k", cross, skew(about))
        along = np.hypot(along - c, turn) + c
    left = 1.0 - np.square(np.maximum(along, 0.0)) / (power * own)
    best = float(left.min())
    if best > ALIKE:
        return 0, 0.0
    if left[0] <= max(UNLIKE * best, ALIKE):
        return 0, float(along[0] / power)
    tied = np.flatnonzero(left <= TIED * best + 1e-6)
    changed = np.count_nonzero(ways[tied] - np.eye(3), axis=(1, 2))
    number = int(tied[int(np.argmin(changed))])
    return number, float(along[number] / power)
