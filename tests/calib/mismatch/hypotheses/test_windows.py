"""What windows may hold, as functions of time."""

import numpy as np

from calib.mismatch.hypotheses.windows import cosines


def test_cosines_are_those_of_whole_multiples():
    phase = np.linspace(-1.0, np.pi + 1.0, 300)
    for count in (1, 2, 40):
        expected = np.cos(phase[:, None] * np.arange(count))
        assert np.abs(cosines(phase, count) - expected).max() < 1e-12
