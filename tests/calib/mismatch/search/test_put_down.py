"""What fades in the first rest, as fast as the others settle, is no second cause."""

from __future__ import annotations

import numpy as np
import pytest

from calib.mismatch.hypotheses.candidates import Candidate
from calib.mismatch.hypotheses.rivals import FADED, FROM_START
from calib.mismatch.search.accepted import Accepted
from calib.mismatch.search.put_down import put_down


def _accepted(candidate: Candidate) -> Accepted:
    none = np.zeros((4, len(candidate.index)))
    size = np.ones(len(candidate.index))
    return Accepted(candidate, none, size, 0.0 * size, False, 1e9)


def _settling(tau: float) -> Accepted:
    channels, index = ("accel.x", "accel.y"), np.arange(2)
    candidate = Candidate(
        "accel_settling", index, 0.1, True, channels, parameters=("kx", "ky"), shape={"tau": tau}
    )
    return _accepted(candidate)


def _fading(tau: float, *channels: str) -> Accepted:
    index, interval = np.arange(len(channels)), (1.0, 1.0 + FADED * tau)
    return _accepted(Candidate(FROM_START, index, 0.1, False, channels, interval=interval))


@pytest.mark.parametrize(("tau", "same"), [(1.0, True), (2.5, True), (12.0, False), (0.3, False)])
def test_it_is_as_fast_as_the_others(tau: float, same: bool) -> None:
    found = put_down([_fading(2.0, "accel.y"), _settling(tau)])
    assert found == ({0: 1} if same else {})


def test_a_gyroscope_does_not_settle() -> None:
    assert put_down([_settling(2.0), _fading(2.0, "gyro.x", "gyro.y", "gyro.z")]) == {}


def test_without_a_settling_it_is_what_nobody_has_a_name_for() -> None:
    assert put_down([_fading(2.0, "accel.x", "accel.y", "accel.z")]) == {}
