"""Noise that goes with a motion that samples do not resolve."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, sosfilt

from calib.effects.base import State
from calib.effects.vibration import vibration_variance
from calib.mismatch import diagnose_reference
from calib.mismatch.reference.band import beyond
from calib.mismatch.reference.colour import WHITE, Blur, Colour, gaussian, whitening
from calib.mismatch.reference.filters import low_passed, smoothed
from calib.mismatch.reference.scatter import Scatter, _of_parts, scatter
from calib.mismatch.reference.shapes import find_shapes
from calib.mismatch.reference.windowed import make_rows
from calib.mismatch.rows.rows import Kind, Rows
from calib.recording import CHANNELS, Recording
from calib.rotation import skew

STEP = 0.02
N = 16000


@pytest.fixture(scope="module")
def tumbled() -> State:
    """Rests, with a turn of a second every four, and a shaken part."""
    rng = np.random.default_rng(1)
    time = STEP * np.arange(N)
    turned = (time % 4.0 < 1.0)[:, None] * np.sin(np.pi * (time % 4.0))[:, None]
    axes = rng.normal(size=(N // 200, 3))[np.arange(N) // 200]
    shaken = (time > 280.0)[:, None] * rng.normal(size=(N, 3))
    force = np.tile([0.0, 0.0, 9.8], (N, 1)) + 3.0 * shaken
    return State(time, force, turned * axes + shaken)


def noisy(state: State, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return differences that scatter with the fourth power of the rate, and their variance."""
    rate = np.square(state.rate).sum(axis=1)
    variance = np.outer(0.01 + np.square(rate), np.ones(6))
    return np.sqrt(variance) * rng.normal(size=(N, 6)), variance


def blurred(state: State) -> Blur:
    return gaussian(state.time, 1.1 * STEP, STEP)


def shown(state: State) -> list[tuple[str, np.ndarray]]:
    """Return what the motion makes of a scale factor error and of an arm."""
    turn = skew(state.rate)
    arm = (turn @ turn + skew(state.rate_dot))[:, :, 0]
    return [(c, state.rate[:, i % 3]) for i, c in enumerate(CHANNELS)] + [
        (c, arm[:, i % 3]) for i, c in enumerate(CHANNELS)
    ]


def windows(
    state: State,
    left: np.ndarray,
    columns: list[tuple[str, np.ndarray]],
    blur: Blur,
    rough: Scatter | None,
) -> tuple[Rows, np.ndarray]:
    """Return the rows of windows, and their squares relative to the variance that they state."""
    rows = make_rows(
        find_shapes(state.time, left, blur.see_columns(columns), blur=blur, scatter=rough),
        state,
        left,
        names=("gyro.bias.x",),
        nuisance=[{"gyro.x": np.ones(N)}],
        aligned=(),
        prior=np.array([[0.0, 2.0], [0.0, 0.1]]),
    )
    return rows, np.square(rows.residual) / np.append(np.diag(rows.white), rows.white_diagonal)


def test_the_variance_of_samples_is_found_beside_what_effects_explain(tumbled):
    left, variance = noisy(tumbled, np.random.default_rng(2))
    columns = shown(tumbled)
    for c, name in enumerate(CHANNELS):
        for channel, values in columns:
            left[:, c] += 2.0 * values * (channel == name)
    blur = blurred(tumbled)
    found = scatter(tumbled, left, blur.see_columns(columns), blur=blur, resolved=False).variance
    for own in (variance[:, 0] < 0.02, variance[:, 0] > 1.0):
        assert np.allclose(np.median(found[own] / variance[own], axis=0), 1.0, atol=0.2)


def test_what_is_folded_into_the_band_scatters_where_there_is_something_beyond_it(tumbled):
    rng = np.random.default_rng(8)
    tremor = (tumbled.time % 4.0 < 1.0)[:, None] * np.array([0.5, 0.02])
    variance = 1e-4 + 0.1 * np.repeat(tremor, 3, axis=1)
    left = np.sqrt(variance) * rng.normal(size=(N, 6))
    seen = {"blur": blurred(tumbled), "resolved": True, "folded": tremor}
    still = replace(tumbled, vibration=None)
    views = blurred(tumbled).see_columns(shown(still))
    found = scatter(still, left, views, **seen).variance
    for own in (tremor[:, 0] == 0.0, tremor[:, 0] > 0.0):
        assert np.allclose(np.median(found[own] / variance[own], axis=0), 1.0, atol=0.2)


def test_beyond_the_band_is_what_is_fast_and_no_noise():
    rng = np.random.default_rng(9)
    time = np.arange(6000) / 100.0
    fast = (time % 6.0 < 1.0) * np.sin(2 * np.pi * 30.0 * time)
    slow = np.sin(2 * np.pi * time)
    signal = np.outer(slow + fast, [1.0, 0.0, 0.0])
    whole = Recording(time, 0.01 * rng.normal(size=signal.shape), signal, "device")
    power = beyond(whole, low_passed(whole, 10.0), 10.0)
    inside = (time % 6.0 > 0.2) & (time % 6.0 < 0.8)
    assert np.allclose(power[inside, 1], 0.5, atol=0.1)
    quiet = (time % 6.0 > 2.0) & (time % 6.0 < 5.0)
    assert np.median(power[quiet, 0]) == 0.0
    assert power[quiet, 1].max() < 1e-3


@pytest.mark.parametrize("known", [True, False])
def test_rows_within_a_turn_are_as_noisy_as_they_say(tumbled, known):
    left, _ = noisy(tumbled, np.random.default_rng(3))
    blur, columns = blurred(tumbled), shown(tumbled)
    rough = (
        scatter(tumbled, left, blur.see_columns(columns), blur=blur, resolved=False)
        if known
        else None
    )
    rows, ratio = windows(tumbled, left, columns, blur, rough)
    early = rows.interval[rows.segment, 1] < 280.0
    if known:
        for kind in (Kind.MEAN, Kind.CONTRAST):
            assert 0.7 < np.mean(ratio[(rows.kind == kind) & early]) < 1.4
    else:
        # The noise of a window is that of its rest.
        assert np.mean(ratio[(rows.kind == Kind.CONTRAST) & early]) > 2.0


@pytest.mark.parametrize("colour", [WHITE, Colour(0.1, 0.0)])
def test_a_window_that_is_shaken_in_part_is_as_noisy_as_it_says(tumbled, colour):
    """What vibration adds is white; a captured motion's own noise is not, but is made so."""
    rng = np.random.default_rng(4)
    time, band = tumbled.time, 5.0
    shaken = (time % 8.0 > 2.0) & (time % 8.0 < 5.0)
    own = np.fft.rfft(rng.normal(0, 0.1, (N, 6)), axis=0)
    own *= np.sqrt(colour.at(np.fft.rfftfreq(N, STEP)))[:, None]
    left = np.fft.irfft(own, N, axis=0) + shaken[:, None] * rng.normal(size=(N, 6))
    left = smoothed(STEP * np.arange(len(left)), left, band)
    state = replace(tumbled, vibration=np.tile(1.0 * shaken[:, None], (1, 3)))
    blur = whitening(time, [colour, colour], STEP, (band, band))
    columns = shown(state)
    rough = scatter(state, left, blur.see_columns(columns), blur=blur, resolved=True)
    rows, ratio = windows(state, left, columns, blur, rough)
    for kind in (Kind.MEAN, Kind.CONTRAST):
        assert 0.7 < np.mean(ratio[rows.kind == kind]) < 1.4


@pytest.mark.parametrize("seed", [5, 6])
def test_what_a_sensor_that_nothing_shakes_hears_of_its_own_noise_is_no_vibration(tumbled, seed):
    """A captured motion's noise rises with frequency; vibration would be white, and weigh more."""
    rng = np.random.default_rng(seed)
    band, colour = 5.0, Colour(1.0, 0.0)
    own = np.fft.rfft(rng.normal(0, 0.1, (N, 6)), axis=0)
    own *= np.sqrt(colour.at(np.fft.rfftfreq(N, STEP)))[:, None]
    left = smoothed(STEP * np.arange(N), np.fft.irfft(own, N, axis=0), band)
    heard = vibration_variance(tumbled.time, rng.normal(0, 0.02, (N, 3)), np.zeros(N, bool))
    state = replace(tumbled, vibration=heard)
    blur = whitening(tumbled.time, [colour, colour], STEP, (band, band))
    columns = shown(state)
    rough = scatter(state, left, blur.see_columns(columns), blur=blur, resolved=True)
    rows, ratio = windows(state, left, columns, blur, rough)
    for c in range(len(CHANNELS)):
        for kind in (Kind.MEAN, Kind.CONTRAST):
            assert 0.6 < np.mean(ratio[(rows.kind == kind) & (rows.channel == c)]) < 1.5


def test_what_shakes_is_heard_beside_it_as_the_low_pass_spreads_it(tumbled):
    rng = np.random.default_rng(8)
    band, colour = 5.0, Colour(0.2, 0.0)
    loud = 100.0 * ((tumbled.time % 8.0 > 2.0) & (tumbled.time % 8.0 < 5.0))
    own = np.fft.rfft(rng.normal(0, 0.1, (N, 6)), axis=0)
    own *= np.sqrt(colour.at(np.fft.rfftfreq(N, STEP)))[:, None]
    left = np.fft.irfft(own, N, axis=0) + loud[:, None] * rng.normal(size=(N, 6))
    state = replace(tumbled, vibration=np.tile(np.square(loud)[:, None] / 3.0, (1, 3)))
    blur = whitening(tumbled.time, [colour, colour], STEP, (band, band))
    left, columns = smoothed(STEP * np.arange(len(left)), left, band), shown(state)
    rough = scatter(state, left, blur.see_columns(columns), blur=blur, resolved=True)
    _, ratio = windows(state, left, columns, blur, rough)
    # Of 2000 rows; beside what shakes, noise would be a thousand times what it is elsewhere.
    assert np.sqrt(ratio.max()) < 6.0


ARM = np.array([-0.0189, 0.0189, 0.0])


def shaken_pair(seed: int) -> tuple[Recording, Recording]:
    """Return two IMUs with an arm between, shaken to their full scale and faster than they sample.

    They sample at moments and through low-passes of their own.
    """
    rng = np.random.default_rng(seed)
    fine = 1000.0
    time = np.arange(0.0, 80.0, 1.0 / fine)

    def filtered(low: float, high: float) -> np.ndarray:
        sos = butter(2, [low, high], "band", fs=fine, output="sos")
        out = sosfilt(sos, rng.normal(size=(len(time), 3)), axis=0)
        return np.asarray(out / out.std())

    knocks = np.exp(-np.abs(time % 6.0 - 4.0) / 0.02)[:, None] * (time < 46.0)[:, None]
    turned = (np.abs(time % 6.0 - 3.5) < 0.5) * np.cos(np.pi * (time % 6.0 - 3.5))
    axes = rng.normal(size=(14, 3))[(time // 6.0).astype(int)]
    slow = filtered(1.5, 4.5)
    shaken = np.clip(time - 48.0, 0.0, 1.0)[:, None]
    speed = np.abs(slow[:, :1]) ** 1.5
    rate = (turned * (time < 46.0))[:, None] * 3.0 * axes + 3.0 * knocks * filtered(5.0, 120.0)
    rate += shaken * (15.0 * slow + 3.0 * speed * filtered(4.0, 90.0))
    # Nothing here depends on where down is.
    force = np.tile([0.0, 0.0, 9.8], (len(time), 1)) + 20.0 * knocks * filtered(5.0, 120.0)
    force += shaken * 25.0 * speed * filtered(1.0, 150.0)
    turn = skew(rate)
    felt = force + (turn @ turn + skew(np.gradient(rate, 1.0 / fine, axis=0))) @ ARM
    at = np.arange(0.1, 79.9, 0.016)

    def sensed(force: np.ndarray, cutoff: float, late: float) -> Recording:
        sos = butter(1, cutoff, "low", fs=fine, output="sos")
        signals = sosfilt(sos, np.hstack((force, rate)), axis=0).T
        accel, gyro = np.split(np.stack([np.interp(at + late, time, s) for s in signals], 1), 2, 1)
        accel = accel + rng.normal(0, 0.05, accel.shape)
        gyro = np.clip(gyro + rng.normal(0, 0.004, gyro.shape), -34.9, 34.9)
        return Recording(at, accel, gyro, "device")

    return sensed(felt, 260.0, 0.0), sensed(force, 120.0, 0.0006)


@pytest.mark.long
def test_the_arm_between_two_imus_is_right_when_they_are_shaken_harder_than_they_resolve():
    found = diagnose_reference(*shaken_pair(5), gravity=9.80665)
    assert {f.effect for f in found.findings} <= {
        "saturation",
        "time_offset",
        "accel_lever_arm",
    }
    assert not found.unexplained
    (item,) = (f for f in found.findings if f.effect == "accel_lever_arm")
    for true, q in zip(ARM, item.parameters.values(), strict=True):
        assert q.sigma < 1e-3
        assert abs(q.value - true) < 3.0 * q.sigma


def test_no_sample_is_without_noise():
    """At rest a sensor that is hardly noisy has nothing of what it errs by in motion."""
    moves = (np.arange(600) > 200).astype(float)
    errs = 3.0 * moves * np.random.default_rng(5).normal(size=600)
    parts = np.stack((np.ones(600), moves), axis=1)
    share = _of_parts(parts, errs, np.zeros((600, 1)), 1.0, np.zeros(600))
    assert share[0] > 0
    assert share[1] == pytest.approx(9.0, rel=0.2)


def test_points_through_which_nothing_is_seen_show_no_share_of_it(tumbled: State) -> None:
    """Of an accelerometer that is judged at rest; it was zero divided by zero."""
    left = noisy(tumbled, np.random.default_rng(2))[0]
    resting = np.linalg.norm(tumbled.rate, axis=1) < 1e-3
    blur = blurred(tumbled).judging(resting)
    found = scatter(tumbled, left, blur.see_columns(shown(tumbled)), blur=blur, resolved=False)
    assert np.isfinite(found.variance).all()
    assert np.isfinite(found.seen).all()
