"""The motion between two witnesses of it: a truth with noise of its own, and the recording.

Both err. With the noise n of the truth the differences hold ``-n``, and so does whatever effects
make of its signals: these go together. A scale factor looks smaller than it is, by the power of
that noise relative to the motion's; of its second derivative ``d²n/dt²`` a truth that was not
smoothed looks sharpened. Weighed against each other by what either errs by, so that the variance is
least, the two leave an error that has nothing in common with their difference.

References
----------
.. [1] A. Papoulis, "Probability, Random Variables, and Stochastic Processes", 3rd ed., 1991, p. 175
   (the principle of orthogonality).
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from calib.effects.base import State
from calib.mismatch.reference.band import filtered
from calib.mismatch.reference.colour import Colour
from calib.types import FloatArray


def witnessed(state: State, left: FloatArray, colours: list[Colour]) -> State:
    """Return a state with force and rate as truth and recording have them between them.

    The sensor's noise is white, the truth's is that of derivatives. So of the spectrum ``1 + a f² +
    b f⁴`` of the differences the first term counts as the sensor's, and the others as the truth's.

    Parameters
    ----------
    state : State
        The truth at the n points.
    left : (n, 6) array
        Recording minus model.
    colours : two of Colour
        Of the differences of accelerometer and gyroscope.
    """
    force, rate = (
        filtered(state.time, own, partial(_of_truth, colour))
        for own, colour in zip((left[:, :3], left[:, 3:]), colours, strict=True)
    )
    return replace(state, force=state.force + force, rate=state.rate + rate)


def _of_truth(colour: Colour, frequency: FloatArray) -> FloatArray:
    """Return the truth's share of the variance of differences at (n,) frequencies, Hz."""
    return np.asarray(1.0 - 1.0 / colour.at(frequency))
