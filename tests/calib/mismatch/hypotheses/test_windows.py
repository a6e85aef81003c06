"""What windows may hold, as functions of time."""

import numpy as np

from calib.mismatch.hypotheses.candidates import FLUCTUATING, Candidate
from calib.mismatch.hypotheses.windows import cosines, fluctuating, touched
from calib.recording import CHANNELS


def test_cosines_are_those_of_whole_multiples():
    phase = np.linspace(-1.0, np.pi + 1.0, 300)
    for count in (1, 2, 40):
        expected = np.cos(phase[:, None] * np.arange(count))
        assert np.abs(cosines(phase, count) - expected).max() < 1e-12


def test_what_axes_share_is_on_those_that_have_a_share():
    none = np.zeros(0, np.int64)
    plain = Candidate(FLUCTUATING, none, 1.0, False, CHANNELS[3:], interval=(0.0, 9.0))
    assert touched(plain) == CHANNELS[3:]
    share = np.array([0.8, 0.0, -0.6])
    shared = fluctuating(plain, 1.0, 5.0, segments=6, share=share)
    assert touched(shared) == ("gyro.x", "gyro.z")
    assert shared.channels == CHANNELS[3:]
    assert fluctuating(plain, 1.0, 5.0, segments=6).shape == {"order": 6.0, "corner": 6.0}
