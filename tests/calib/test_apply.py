"""Correcting a stream block by block is correcting it whole."""

import numpy as np
import pytest

from calib.apply import Block, Corrector, correct_recording
from calib.calibration import Calibration, Gravity, Housing, TemperatureRange
from calib.effects.base import (
    State,
    Term,
)
from calib.model import SensorModel, Triad
from calib.recording import Recording
from calib.rotation import mat_from_rotvec


def recording(n: int = 3000) -> Recording:
    time = 1e3 + np.arange(n) * 0.01
    phase = time[:, None] + np.arange(3)
    return Recording(
        time=time,
        accel=9 * np.sin(2 * phase),
        gyro=np.cos(3 * phase) * (np.sin(time) > 0)[:, None],
        clock="device",
        temperature=20 + (time - time[0]) / 6,
    )


TRIADS = (
    Triad(
        np.array([0.1, -0.2, 0.3]),
        np.array([0.01, 0.02, -0.01]),
        np.tril(np.full((3, 3), 0.01), -1),
    ),
    Triad(np.array([0.01, 0.02, 0.03]), np.array([0.02, -0.02, 0.01]), 0.01 * (1 - np.eye(3))),
)
G_SENSITIVITY = Term("gyro_g_sensitivity", {"gxy": 1e-3, "gzz": -2e-3})


def calibration(*terms: Term, housing: Housing | None = None) -> Calibration:
    model = SensorModel(*TRIADS, terms)
    return Calibration(
        model,
        (),
        np.zeros((0, 0)),
        (),
        Gravity(9.80665),
        temperature=TemperatureRange(21.0, 24.0),
        housing=housing,
    )


@pytest.mark.parametrize(
    ("terms", "lags"),
    [
        ((), False),
        ((G_SENSITIVITY,), False),
        ((Term("accel_lever_arm", {"rx": 0.02}),), True),
        ((Term("gyro_temperature_rate", {"kx": 0.1}),), True),
        ((Term("accel_settling", {"kx": 0.1, "tau": 0.1}),), True),
        ((Term("accel_vibration_rectification", {"kz": 0.1}),), True),
        (
            (
                G_SENSITIVITY,
                Term("accel_size_effect", {"ryx": 2e-3}),
                Term("gyro_warm_up", {"ky": 0.1, "tau": 3.0}),
                Term("time_offset", {"gyro_delay": 0.0234}),
            ),
            True,
        ),
    ],
)
@pytest.mark.parametrize("size", [250, 2999])
def test_blocks_of_any_size_give_the_whole(terms: tuple[Term, ...], lags: bool, size: int) -> None:
    whole, cal = recording(), calibration(*terms)
    expected = cal.correct(
        State(whole.time, whole.accel, whole.gyro, whole.temperature, power_on=whole.time[0])
    )
    corrector = Corrector(cal, whole.interval)
    assert (corrector.margin > 0) is lags
    parts = []
    for k in range(0, len(whole), size):
        part = whole.slice(k, k + size)
        parts.append(corrector.add(Block(part.time, part.accel, part.gyro, part.temperature)))
        if not lags:
            assert len(parts[-1][0]) == len(part)
    parts.append(corrector.finish())
    np.testing.assert_allclose(np.concatenate([p[0] for p in parts]), expected.accel, atol=1e-7)
    np.testing.assert_allclose(np.concatenate([p[1] for p in parts]), expected.gyro, atol=1e-7)


def test_distorted_signals_come_back() -> None:
    truth = recording()
    cal = calibration(G_SENSITIVITY)
    measured = cal.model.distort(State(truth.time, truth.accel, truth.gyro))
    seen = Recording(time=truth.time, accel=measured.accel, gyro=measured.gyro, clock="device")
    corrected = correct_recording(cal, seen)
    np.testing.assert_allclose(corrected.accel, truth.accel, atol=1e-9)
    np.testing.assert_allclose(corrected.gyro, truth.gyro, atol=1e-9)


def test_a_known_housing_turns_the_output() -> None:
    mat_hs = mat_from_rotvec(np.array([0.1, 0.2, -0.3]))
    housing = Housing(mat_hs, np.zeros(3), 0.0, 6)
    plain = correct_recording(calibration(), recording())
    turned = correct_recording(calibration(housing=housing), recording())
    np.testing.assert_allclose(turned.accel[3], mat_hs @ plain.accel[3], atol=1e-12)
    np.testing.assert_allclose(turned.gyro[3], mat_hs @ plain.gyro[3], atol=1e-12)


def test_coverage_counts_what_is_outside_the_temperature_range() -> None:
    whole = recording()
    corrector = Corrector(calibration(), whole.interval)
    corrector.add(Block(whole.time, whole.accel, whole.gyro, whole.temperature))
    assert whole.temperature is not None
    cold, hot = (whole.temperature < 21).sum(), (whole.temperature > 24).sum()
    assert corrector.coverage.outside == cold + hot
    assert (corrector.coverage.low, corrector.coverage.high) == (20.0, whole.temperature[-1])


def test_one_bad_sample_costs_only_itself() -> None:
    whole = recording()
    cal = calibration(
        Term("accel_lever_arm", {"rx": 0.02}), Term("gyro_scale_asymmetry", {"kx": 1e-3})
    )
    expected = correct_recording(cal, whole)
    accel, temperature = whole.accel.copy(), np.array(whole.temperature)
    accel[1000, 1] = np.nan
    temperature[[5, 1500]] = np.nan
    corrector = Corrector(cal, whole.interval)
    parts = [corrector.add(Block(whole.time, accel, whole.gyro, temperature)), corrector.finish()]
    found = np.concatenate([part[0] for part in parts])
    assert np.isnan(found[1000]).all()
    kept = np.arange(len(whole)) != 1000
    near = np.abs(np.arange(len(whole)) - 1000) < 20
    np.testing.assert_allclose(found[kept & ~near], expected.accel[kept & ~near], atol=1e-9)
    np.testing.assert_allclose(found[kept], expected.accel[kept], atol=1e-3)
