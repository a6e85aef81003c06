"""A gyroscope that a queue held back is diagnosed beside its accelerometer."""

from dataclasses import replace

import numpy as np
import pytest

from calib.effects.base import Term
from calib.mismatch import diagnose_recording
from calib.mismatch.realigned import HELD, LEFT, coarse_delay, mostly_prompt, with_all
from calib.recording import Recording

from .bench import GRAVITY, recording


def late(real: Recording, delay: float) -> Recording:
    k, n = round(delay / real.interval), len(real)
    if k >= 0:
        return replace(real.slice(k, n), gyro=real.gyro[: n - k])
    return replace(real.slice(0, n + k), gyro=real.gyro[-k:])


@pytest.mark.parametrize("delay", [0.2, -0.2, 0.46])
def test_whole_samples_of_a_delay_are_undone(delay: float) -> None:
    real = recording(rate=50.0)
    found, undone = mostly_prompt(late(real, delay), delay)
    assert undone == pytest.approx(np.sign(delay) * (abs(delay) - LEFT))
    left = late(real, np.sign(delay) * LEFT)
    a = int(np.searchsorted(left.time, found.time[0] - 1e-6))
    b = a + len(found)
    assert len(left) - len(found) <= round(2 * abs(delay) / real.interval)
    np.testing.assert_allclose(found.time, left.time[a:b])
    np.testing.assert_array_equal(found.accel, left.accel[a:b])
    np.testing.assert_allclose(found.gyro, left.gyro[a:b], atol=1e-9)


@pytest.mark.long
@pytest.mark.parametrize("delay", [0.24, -0.16])
def test_a_gyroscope_that_was_held_back_is_diagnosed_with_all_else(delay: float) -> None:
    step = Term("gyro_g_sensitivity", {"gxx": 3e-4, "gyy": -2e-4, "gzx": 2e-4})
    real = late(recording(step, seed=12), delay)
    found = diagnose_recording(real, gravity=GRAVITY)
    effects = {f.effect: f.parameters for f in found.findings}
    assert set(effects) == {"time_offset", "gyro_g_sensitivity"}
    assert not found.unexplained
    q = effects["time_offset"]["gyro_delay"]
    assert q.sigma is not None
    assert q.sigma < 3e-4
    assert q.value == pytest.approx(delay, abs=3 * q.sigma)
    (term,) = (t for t in found.model.terms if t.effect == "time_offset")
    assert term.parameters["gyro_delay"] == pytest.approx(delay, abs=1e-3)
    assert found.summary["samples"] == len(real)
    assert not any("one clock" in need for need in found.missing)


def test_what_has_no_delay_is_not_given_one() -> None:
    found = diagnose_recording(recording(), gravity=GRAVITY)
    assert coarse_delay(found.findings) is None
    assert with_all(found, 0.1) is None


def test_what_is_of_another_clock_is_left_there() -> None:
    real = late(recording(seed=12), HELD + 0.3)
    found = diagnose_recording(real, gravity=GRAVITY)
    assert coarse_delay(found.findings) is None
    assert any("one clock" in need for need in found.missing)
