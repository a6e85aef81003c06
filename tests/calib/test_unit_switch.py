"""A recording of which one part is in another unit."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from calib import calibrate
from calib.errors import UnitError
from calib.mismatch import diagnose_recording
from calib.model import SensorModel
from calib.recording import Recording
from calib.simulate import simulate
from calib.simulation.library import MOTIONS, make_motion
from calib.simulation.noise import CONSUMER
from calib.unit_switch import unit_switches

GRAVITY = 9.80665
DEGREES = 180.0 / np.pi


@cache
def recorded(name: str = "bench", seed: int = 51) -> Recording:
    rng = np.random.default_rng(seed)
    motion = make_motion(name, rng=rng, duration=120.0, gravity=GRAVITY)
    return simulate(motion, SensorModel(), CONSUMER, rng=rng, rate=50.0)


def switched(recording: Recording, triad: str, factor: float, start: float, stop: float):
    inside = (recording.time >= start) & (recording.time <= stop)
    values = getattr(recording, triad) * np.where(inside, factor, 1.0)[:, None]
    return replace(recording, **{triad: values})


@pytest.mark.parametrize("name", MOTIONS)
@pytest.mark.parametrize("seed", [52, 53])
def test_a_recording_in_one_unit_has_no_switch(name: str, seed: int) -> None:
    assert not unit_switches(recorded(name, seed))


def test_a_sensor_that_is_first_at_rest_and_then_waved_about_has_none() -> None:
    rest, wave = recorded("thermal", 54), recorded("hand-held", 54)
    n = len(rest)
    late = np.arange(n)[:, None] > n // 2
    mixed = replace(
        rest,
        accel=np.where(late, wave.accel[:n], rest.accel),
        gyro=np.where(late, wave.gyro[:n], rest.gyro),
    )
    assert not unit_switches(mixed)


@pytest.mark.parametrize(
    ("triad", "factor"),
    [
        ("gyro", DEGREES),
        ("gyro", 1 / DEGREES),
        ("gyro", 1e3),
        ("accel", 1 / GRAVITY),
        ("accel", 1e3 / GRAVITY),
        ("accel", 0.25),
    ],
)
@pytest.mark.parametrize("span", [(60.0, 120.0), (0.0, 50.0), (80.0, 120.0)])
def test_the_part_in_another_unit_is_found(
    triad: str, factor: float, span: tuple[float, float]
) -> None:
    (found,) = unit_switches(switched(recorded(seed=55), triad, factor, *span))
    assert found.triad == triad
    assert found.factor == pytest.approx(factor, rel=0.03)
    # At rest a block of the other unit may look like one with more noise.
    assert found.interval == pytest.approx(span, abs=3.0)


def test_one_axis_in_another_unit_is_no_switch() -> None:
    made = recorded(seed=57)
    for factor in (4.0, 1e3 / GRAVITY, 1 / GRAVITY):
        assert not unit_switches(replace(made, accel=made.accel * [1.0, 1.0, factor]))


def test_it_is_named_with_its_part_and_not_calibrated() -> None:
    bad = switched(recorded(seed=56), "gyro", DEGREES, 80.0, 120.0)
    found = diagnose_recording(bad, gravity=GRAVITY)
    (item,) = found.findings
    assert item.effect == "unit_error"
    assert item.intervals[0] == pytest.approx((80.0, 120.0), abs=3.0)
    assert "deg/s" in item.sentence
    with pytest.raises(UnitError, match="the gyroscope is in deg/s there"):
        calibrate.calibrate(bad, gravity=GRAVITY)
