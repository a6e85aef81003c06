"""Whether a recording and a captured motion have samples enough for how the body turns.

Both are compared up to `RESOLVED` of the slower one's rate. What is faster is folded, or rounded
off, by filters and at moments of their own; as long as it is noise beside the turns, it counts as
noise. Where it is a good part of the turns, or these begin and end between two samples and gravity
bends by more than noise in between, differences are made of it, and would have some effect's name.
"""

from __future__ import annotations

import numpy as np

from calib.errors import NoCommonMotionError
from calib.mismatch.reference.band import RESOLVED, Matched, beyond, noise_of
from calib.mismatch.reference.carried import LIMITS
from calib.mismatch.reference.corners import MOVES
from calib.mismatch.reference.filters import NARROWEST, low_passed
from calib.mismatch.reference.truths import RecordingTruth
from calib.recording import Recording

ENOUGH = 50.0
"""Hz at which samples resolve 15 Hz: a body that is moved by hand has next to nothing beyond."""

PART = LIMITS["scale_factor_error"]
"""Of the rate of turns, that is not resolved where it is no noise any more: what a data sheet
allows a scale factor."""


class TooFewError(NoCommonMotionError):
    """Samples that are too few for the turns that are to be compared."""


def check_enough(real: Recording, truth: RecordingTruth, common: Matched) -> None:
    """Refuse samples that are too few for the turns: of a recording, or of a captured motion.

    Raises
    ------
    TooFewError
    """
    other, lost = truth.recording, ""
    own = real.interval >= other.interval
    slow, fast = (real, other) if own else (other, real)
    rate = 1.0 / slow.interval
    if rate >= ENOUGH:
        return
    if own and common.jerky and bent(real, truth.gravity) > noise_of(real)[0]:
        lost = "they begin and end between two of them"
    elif RESOLVED * rate < NARROWEST and (part := unresolved(fast, RESOLVED * rate)) > PART:
        lost = f"{100 * part:.2g} % of them is faster than the {RESOLVED * rate:.2g} Hz that show"
    if lost:
        name = "the recording" if own else "the reference"
        raise TooFewError(
            f"samples to compare: {name} has too few a second for these turns, {rate:.3g}: {lost}; "
            f"take {ENOUGH:g} a second or more, or turn more slowly"
        )


def bent(recording: Recording, gravity: float) -> float:
    """Return what gravity differs by from a straight line between two samples of turns, m/s².

    A vector that turns by a small angle ``a`` is off its chord by ``a² / 12`` of itself on average.
    """
    power = np.square(recording.gyro - np.median(recording.gyro, axis=0)).sum(axis=1)
    moves = power > MOVES**2
    if not moves.any():
        return 0.0
    return gravity * recording.interval**2 / 12.0 * float(power[moves].mean())


def unresolved(recording: Recording, bandwidth: float) -> float:
    """Return what share of its rate, by root-mean-square, a motion has beyond a bandwidth (Hz).

    Beside noise, that rests have as well; of samples that move.
    """
    kept = low_passed(recording, bandwidth)
    rate = kept.gyro - np.median(kept.gyro, axis=0)
    power = np.square(rate).sum(axis=1)
    moves = power > MOVES**2
    if not moves.any():
        return 0.0
    return float(np.sqrt(beyond(recording, kept, bandwidth)[moves, 1].mean() / power[moves].mean()))
