"""A captured motion with what a smoothing took from it put back.

A low-pass that leaves ``1 / (1 + k (2 pi f)² + m (2 pi f)⁴)`` is undone by that polynomial, as far
up as what is compared reaches: beside a motion that is right an arm, a gain or a lost sample looks
as it does. Beside a smoothed one, with smoothing as one more linear term, it does not: of a tremor
at 10 Hz a low-pass at 4 Hz leaves a fortieth.

``m`` alone is a Butterworth of second order forwards and backwards. Of samples at steps T that is a
bilinear transform: a filter of the frequency ``tan(pi f T) / (pi T)``, 5 % more at 12 of 100 Hz.

References
----------
.. [1] A. V. Oppenheim, R. W. Schafer, "Discrete-Time Signal Processing", 3rd ed., 2010, section
   7.2.2 (bilinear transformation).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from calib.effects.base import State
from calib.mismatch.reference.band import RESOLVED
from calib.mismatch.reference.filters import filtered
from calib.mismatch.reference.truths import RecordingTruth
from calib.mismatch.reference.unsmoothed import ANGLES, PLACES, SLUG
from calib.model import SensorModel
from calib.types import FloatArray

Sharpen = Callable[[Mapping[str, float]], RecordingTruth]
"""Returns a truth as it was before it was smoothed by so much."""

REACH = 2.0
"""Times the cut-off of what is compared up to which what was lost is put back: of what is faster
the comparison sees less than a 250th, and noise would go on growing."""


class Sharpened:
    """A truth, as it is and as it was before it was smoothed.

    Parameters
    ----------
    truth : RecordingTruth
    sharpen : Sharpen, optional
        None for a truth that nobody smoothed, or that has no orientations.
    """

    def __init__(self, truth: RecordingTruth, sharpen: Sharpen | None) -> None:
        self.truth, self.sharpen = truth, sharpen
        self._made: list[tuple[dict[str, float], RecordingTruth]] = []

    def before(self, lost: Mapping[str, float]) -> RecordingTruth:
        """Return the truth before it lost so much; it is kept until two others were asked for."""
        if self.sharpen is None or not lost:
            return self.truth
        for sizes, truth in self._made:
            if sizes == lost:
                return truth
        self._made = [*self._made[-1:], (dict(lost), self.sharpen(lost))]
        return self._made[-1][1]

    def sensor(self, model: SensorModel) -> SensorModel:
        """Return the model of the sensor alone, which senses the motion as it was."""
        if self.sharpen is None or not lost_by(model):
            return model
        return replace(model, terms=tuple(t for t in model.terms if t.effect != SLUG))


def lost_by(model: SensorModel) -> dict[str, float]:
    """Return by how much a model says that the truth was smoothed; nothing if that is no low-pass.

    It is none where ``1 + k x + m x²`` falls below 3/4 for some x above 0: undone it would be one,
    and a step that overshoots would not return. There the term is one like any other.
    """
    out: dict[str, float] = {}
    for term in model.terms:
        for name, size in term.parameters.items() if term.effect == SLUG else ():
            out[name] = out.get(name, 0.0) + size
    for both in (ANGLES, PLACES):
        square, fourth = (out.get(name, 0.0) for name in both)
        if fourth < 0.0 or (square < 0.0 and square**2 > fourth):
            return {}
    return out


def completed(said: Mapping[str, float], seen: Mapping[str, float]) -> dict[str, float]:
    """Return what a model says was lost, and what was seen of angles or positions it says none of.

    Of either both powers of the frequency go together: what one takes the other does not.
    """
    out = dict(said)
    for both in (ANGLES, PLACES):
        if not any(name in said for name in both):
            out |= {name: seen[name] for name in both if name in seen}
    return out


def sharpening(
    frequency: FloatArray,
    sizes: Mapping[str, float],
    *,
    bands: tuple[float, float],
    interval: float,
) -> FloatArray:
    """Return what undoes a smoothing of these sizes at frequencies (m,), Hz: of both, (m, 2).

    Parameters
    ----------
    frequency, sizes : (m,) array, Hz; mapping
        Sizes of angles and positions, as `reference_smoothing` has them.
    bands : two floats, Hz
        Cut-offs of what is compared, of forces and rates.
    interval : float, s
        Between the samples that were smoothed.
    """
    square = np.square(2.0 * np.pi * frequency)
    within = np.pi * np.minimum(frequency * interval, RESOLVED)
    warped = (2.0 * np.tan(within) / interval) ** 4
    lost = [sizes.get(a, 0.0) * square + sizes.get(b, 0.0) * warped for a, b in (ANGLES, PLACES)]
    felt, turned = (1.0 / (1.0 + (frequency / (REACH * band)) ** 8) for band in bands)
    return 1.0 + np.stack((turned * lost[0], felt * lost[1]), axis=1)


def dulled(
    state: State, sizes: Mapping[str, float], *, bands: tuple[float, float], interval: float
) -> State:
    """Return what a capture that was smoothed by so much shows of a motion.

    By force and rate in the room: what they are the derivatives of was smoothed there.
    """
    mat = state.mat_ns
    assert mat is not None

    def response(frequency: FloatArray) -> FloatArray:
        angles, places = 1.0 / sharpening(frequency, sizes, bands=bands, interval=interval).T
        return np.stack([places] * 3 + [angles] * 3, axis=1)

    room = np.hstack([np.einsum("nij,nj->ni", mat, own) for own in (state.force, state.rate)])
    seen = filtered(state.time, room, response)
    force, rate = (np.einsum("nij,ni->nj", mat, own) for own in (seen[:, :3], seen[:, 3:]))
    return replace(state, force=force, rate=rate)
