"""Correcting a stream block by block is correcting it whole."""

from dataclasses import replace

import numpy as np
import pytest

from calib.apply import Block, Corrector, correct_recording
from calib.calibration import Calibration, Gravity, Housing, TemperatureRange
from calib.effects import effects
from calib.effects.base import Effect, State, Term
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


def coarse(rate: float = 20.0) -> tuple[Recording, np.ndarray]:
    """Return a sensor at rest that warms up, its thermometer read once a second in half kelvins."""
    time = np.arange(0.0, 600.0, 1 / rate)
    true = 25.0 + 12.0 * (1.0 - np.exp(-time / 250.0))
    second = np.floor(time) / 1.0
    noise = np.random.default_rng(3).normal(0, 0.05, 600)[second.astype(int)]
    seen = np.round(2.0 * (25.0 + 12.0 * (1.0 - np.exp(-second / 250.0)) + noise)) / 2.0
    gyro = 0.01 * np.exp(-time / 250.0)[:, None] * (12.0 / 250.0) * np.ones(3)
    still = Recording(
        time=time,
        accel=np.tile([0.0, 0.0, 9.8], (len(time), 1)),
        gyro=gyro,
        clock="device",
        temperature=seen,
    )
    return still, true


WARMING = Term("gyro_temperature_rate", dict.fromkeys(("kx", "ky", "kz"), 0.01))


def test_a_coarse_thermometer_s_steps_do_not_reach_the_output() -> None:
    seen, _ = coarse()
    cal = Calibration(SensorModel(terms=(WARMING,)), (), np.zeros((0, 0)), (), Gravity(9.80665))
    there = np.sqrt(np.mean(seen.gyro**2))
    inside = slice(2000, -2000)
    # Lines through 20 s of the readings each would leave two thirds of it.
    whole = correct_recording(cal, seen).gyro
    assert np.sqrt(np.mean(whole[inside] ** 2)) < 0.06 * there
    # A stream that has not read what comes.
    stream = Corrector(cal, seen.interval)
    parts = [
        stream.add(Block(p.time, p.accel, p.gyro, p.temperature))[1]
        for p in (seen.slice(k, k + 500) for k in range(0, len(seen), 500))
    ]
    left = np.concatenate([*parts, stream.finish()[1]])
    assert np.sqrt(np.mean(left[inside] ** 2)) < 0.4 * there


def test_a_coarse_thermometer_s_steps_are_no_steps_of_a_bias() -> None:
    seen, true = coarse()
    term = Term("gyro_bias_temperature", {"kx": 1e-3, "ky": 0.0, "kz": 0.0})
    model = SensorModel(terms=(term,), reference_temperature=30.0)
    gyro = 1e-3 * (true - 30.0)[:, None] * [1.0, 0.0, 0.0]
    cal = Calibration(model, (), np.zeros((0, 0)), (), Gravity(9.80665))
    left = correct_recording(cal, replace(seen, gyro=gyro)).gyro[:, 0]
    # Half a kelvin is 5e-4.
    assert np.abs(left[500:-500]).max() < 1e-4


SENSORS = [e for e in effects().values() if e.kind == "sensor" and all(i.low for i in e.shape)]


@pytest.mark.parametrize("effect", SENSORS, ids=lambda effect: effect.slug)
def test_every_effect_of_a_sensor_comes_out_of_a_stream_as_out_of_the_whole(
    effect: Effect,
) -> None:
    whole = recording()
    cal = calibration(Term(effect.slug, effect.typical(span=(0.0, 30.0))))
    expected = cal.correct(
        State(whole.time, whole.accel, whole.gyro, whole.temperature, power_on=whole.time[0])
    )
    corrector = Corrector(cal, whole.interval)
    parts = []
    for k in range(0, len(whole), 333):
        part = whole.slice(k, k + 333)
        parts.append(corrector.add(Block(part.time, part.accel, part.gyro, part.temperature)))
    parts.append(corrector.finish())
    np.testing.assert_allclose(np.concatenate([p[0] for p in parts]), expected.accel, atol=1e-6)
    np.testing.assert_allclose(np.concatenate([p[1] for p in parts]), expected.gyro, atol=1e-6)
