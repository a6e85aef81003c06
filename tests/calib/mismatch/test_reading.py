"""A recording is diagnosed as what its sensors measured, whatever reading it made of that."""

from dataclasses import replace

import numpy as np
import pytest

from calib import faults
from calib.effects.base import Term
from calib.mismatch import diagnose_recording
from calib.mismatch.samples.found import SPIKES
from calib.recording import CHANNELS, Recording
from calib.statics import find_poses

from .bench import GRAVITY, recording

TERM = Term("gyro_g_sensitivity", {"gxx": 1e-3, "gzy": -1e-3})


def read_at(real: Recording, rate: float) -> Recording:
    """Return what a host reads that asks so often for the last sample, and stamps the answer."""
    ask = np.arange(real.time[0] + 1e-3, real.time[-1], 1.0 / rate)
    last = np.searchsorted(real.time, ask, side="right") - 1
    assert real.temperature is not None
    return Recording(ask, real.accel[last], real.gyro[last], "host", real.temperature[last])


@pytest.mark.long
def test_effects_are_found_beside_what_was_read_again() -> None:
    found = diagnose_recording(read_at(recording(TERM), 65.0), gravity=GRAVITY)
    again, sensitivity = found.findings
    assert (again.effect, sensitivity.effect) == ("dropped_samples", TERM.effect)
    assert not found.unexplained
    for name, value in TERM.parameters.items():
        q = sensitivity.parameters[name]
        assert q.sigma is not None
        assert abs(q.value - value) < 4 * q.sigma


@pytest.mark.parametrize("triad", ["accel", "gyro"])
def test_nothing_is_found_where_one_triad_measures_half_as_often(triad: str) -> None:
    real = recording(rate=100.0)
    signals = {"accel": real.accel, "gyro": real.gyro}
    signals[triad] = np.repeat(signals[triad][::2], 2, axis=0)[: len(real)]
    held = Recording(real.time, clock="host", temperature=real.temperature, **signals)
    found = diagnose_recording(held, gravity=GRAVITY)
    assert found.verdict == "consistent"
    assert found.summary["held"] in ("accelerometer", "gyroscope")


@pytest.mark.long
def test_a_diagnosis_says_which_samples_are_off_course_and_nothing_else() -> None:
    spikes = {(500, 0): 30.0, (1200, 4): -8.0, (2100, 2): 30.0, (2500, 4): 8.0}
    real = recording(poses=16)
    values = faults.values_of(real)
    for (k, c), size in spikes.items():
        values[k, c] += size
    real = replace(real, accel=values[:, :3], gyro=values[:, 3:])
    found = diagnose_recording(real, gravity=GRAVITY)
    assert not found.findings
    assert {u.follows for u in found.unexplained} == {SPIKES}
    said = {(u.channels, a) for u in found.unexplained for a, _ in u.intervals}
    assert said == {((CHANNELS[c],), float(real.time[k])) for k, c in spikes}


def test_it_is_said_where_no_turn_has_all_of_its_samples() -> None:
    real = recording(TERM)
    assert real.temperature is not None
    packets = np.arange(len(real) // 8 * 8).reshape(-1, 8)
    packets = np.concatenate([np.tile(p, 1 + (k % 3 == 1)) for k, p in enumerate(packets)])
    time = real.time[0] + 0.75 * real.interval * np.arange(len(packets))
    again = Recording(
        time, real.accel[packets], real.gyro[packets], "host", real.temperature[packets]
    )
    found = diagnose_recording(again, gravity=GRAVITY)
    turns = 13
    assert any(f"in {turns} of {turns} some are lost" in need for need in found.missing)
    assert [f.effect for f in found.findings] == ["dropped_samples", TERM.effect]


@pytest.mark.long
def test_spikes_in_a_part_of_a_recording_are_said_of_that_part() -> None:
    real = recording(poses=16)
    rng, gyro = np.random.default_rng(1), real.gyro.copy()
    a, b = len(real) // 3, len(real) // 2
    # In a turn a few look like a motion that does not close.
    poses = find_poses(real)
    rests = [np.arange(x + 3, y - 3, 12) for x, y in zip(poses.start, poses.stop, strict=True)]
    at = np.concatenate(rests)
    at = at[(at >= a) & (at < b)]
    gyro[at, 1] += rng.choice([-8.0, 8.0], len(at))
    found = diagnose_recording(replace(real, gyro=gyro), gravity=GRAVITY)
    assert not found.findings
    (left,) = found.unexplained
    assert (left.follows, left.channels) == (SPIKES, ("gyro.y",))
    ((start, stop),) = left.intervals
    assert start == pytest.approx(real.time[a], abs=2.0)
    assert stop == pytest.approx(real.time[b], abs=2.0)
