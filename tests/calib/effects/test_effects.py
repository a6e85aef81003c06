"""Every effect of the catalogue: whole, consistent with its own columns, and invertible."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import signal
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from calib.effects import effects, get_effect
from calib.effects.accel_settling import FADING, NONE, WHOLE
from calib.effects.bandwidth import cutoff_of, group_delay, low_pass
from calib.effects.base import PRESENCE, Effect, Signals, State, Term, TransformEffect
from calib.effects.text import parse_term
from calib.mismatch.hypotheses.families import forms
from calib.model import SensorModel, Triad
from calib.recording import AXES, CHANNELS
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import NoiseModel

CATALOGUE = [
    "gyro_misalignment",
    "gyro_g_sensitivity",
    "gyro_g_squared_sensitivity",
    "gyro_scale_asymmetry",
    "gyro_scale_quadratic",
    "gyro_scale_nonlinearity",
    "gyro_anisoinertia",
    "gyro_bias_temperature",
    "gyro_scale_temperature",
    "gyro_temperature_rate",
    "gyro_warm_up",
    "gyro_bias_step",
    "gyro_vibration_rectification",
    "earth_rate",
    "accel_quadratic",
    "accel_cubic",
    "accel_cross_product",
    "accel_scale_asymmetry",
    "accel_bias_temperature",
    "accel_scale_temperature",
    "accel_temperature_rate",
    "accel_warm_up",
    "accel_bias_step",
    "accel_settling",
    "accel_lever_arm",
    "accel_size_effect",
    "accel_vibration_rectification",
    "time_offset",
    "inter_axis_skew",
    "clock_scale",
    "bandwidth",
    "dropped_samples",
    "saturation",
    "quantization",
    "unit_error",
    "axis_error",
    "gravity_magnitude",
    "reference_tilt",
    "reference_misalignment",
    "reference_smoothing",
]
SHAPES = {
    "tau": 30.0,
    "moment": 20.0,
    "accel_cutoff": 20.0,
    "gyro_cutoff": 15.0,
    "both_cutoff": 40.0,
    "accel_full_scale": 9.0,
    "gyro_full_scale": 2.0,
    "accel_lsb": 1e-3,
    "gyro_lsb": 1e-4,
    "accel_axes": 13,
    "gyro_axes": 7,
}
LOSSY = {"saturation", "quantization", "dropped_samples", "bandwidth", "reference_smoothing"}
"""What `inverse` cannot undo, or not everywhere; each has a test of its own."""

everyone = pytest.mark.parametrize("slug", CATALOGUE)


@pytest.fixture(scope="module")
def state() -> State:
    motion = bench_protocol(np.random.default_rng(5), poses=8, first_pose=1.0, tremor=0.1)
    state = motion.state(np.arange(0.0, motion.duration, 0.0025))
    shaken = 0.1 + 0.05 * np.sin(state.time[:, None] + np.arange(3))
    return replace(state, vibration=shaken)


def shape_of(effect: Effect) -> dict[str, float]:
    return {p.name: SHAPES[p.name] for p in effect.shape if p.name in SHAPES}


def values_of(effect: Effect) -> dict[str, float]:
    rng = np.random.default_rng(len(effect.slug))
    linear = {
        p.name: 1.0 if p.unit == PRESENCE else 0.5 * p.typical * rng.choice([-1.0, 1.0])
        for p in effect.parameters
    }
    return {**linear, **shape_of(effect)}


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def stacked(signals: Signals) -> dict[str, np.ndarray]:
    whole = np.hstack([signals.accel, signals.gyro])
    return {c: whole[:, i] for i, c in enumerate(CHANNELS)}


def test_the_catalogue_is_whole() -> None:
    assert set(CATALOGUE) <= set(effects())


@everyone
def test_is_fully_described(slug: str) -> None:
    effect = get_effect(slug)
    for name in ("title", "equation", "source", "follows", "needs", "sentence"):
        text = getattr(effect, name)
        assert text, name
        assert text == text.strip(), name
    assert effect.sentence.endswith(".")
    assert effect.parameters or effect.shape
    names = [p.name for p in effect.parameters + effect.shape]
    assert len(set(names)) == len(names)
    for parameter in effect.parameters:
        assert parameter.typical > 0
        assert parameter.unit
        assert parameter.channels
        assert set(parameter.channels) <= set(CHANNELS)
    groups = {"bias", "scale_factor_error", "misalignment"}
    for absorber in effect.absorbed_by:
        triad, group = absorber.split(".")
        assert triad in ("accel", "gyro")
        assert group in groups
    assert set(effect.rivals) <= set(effects()) - {slug}


@everyone
def test_columns_touch_the_channels_that_they_say(slug: str, state: State) -> None:
    effect = get_effect(slug)
    columns = effect.columns(state, shape_of(effect))
    assert list(columns) == [p.name for p in effect.parameters]
    for parameter in effect.parameters:
        column = columns[parameter.name]
        assert set(column) == set(parameter.channels)
        for values in column.values():
            assert values.shape == state.time.shape
            assert np.isfinite(values).all()
        assert any(np.abs(values).max() > 0 for values in column.values())


@everyone
def test_columns_are_the_derivative_of_what_the_model_does(slug: str, state: State) -> None:
    effect = get_effect(slug)
    bare = SensorModel().distort(state)
    columns = effect.columns(state, shape_of(effect))
    for parameter in effect.parameters:
        step = 1.0 if parameter.unit == PRESENCE else 1e-3 * parameter.typical
        term = Term(slug, {**shape_of(effect), parameter.name: step})
        if parameter.unit == PRESENCE:
            off = {p.name: 0.0 for p in effect.parameters if p.name != parameter.name}
            term = Term(slug, {**term.parameters, **off})
        changed = stacked(SensorModel(terms=(term,)).distort(state))
        for channel, before in stacked(bare).items():
            found = (changed[channel] - before) / step
            expected = columns[parameter.name].get(channel, np.zeros_like(before))
            size = max(rms(v) for v in columns[parameter.name].values())
            # Where a tremor sets in at once, what splines and sinusoids make of samples differs.
            most = 4e-2 if slug == "bandwidth" else 5e-3
            assert rms(found - expected) <= most * size, channel


@pytest.mark.parametrize("slug", [slug for slug in CATALOGUE if slug not in LOSSY])
def test_correct_inverts_distort(slug: str, state: State) -> None:
    model = SensorModel(
        Triad(np.array([0.3, -0.2, 0.1]), np.array([0.02, -0.01, 0.03])),
        Triad(np.array([0.02, -0.01, 0.03]), np.array([0.01, -0.02, 0.03])),
        (Term(slug, values_of(get_effect(slug))),),
    )
    measured = model.distort(state)
    true = model.correct(
        replace(state, force=measured.accel, rate=measured.gyro, angular_acceleration=None)
    )
    inside = slice(200, -200)  # a shifted signal has nothing to take beyond its ends
    bare = replace(model, terms=()).distort(state)
    for found, expected, changed, before in zip(
        true, (state.force, state.rate), measured, bare, strict=True
    ):
        size, left = rms((changed - before)[inside]), rms((found - expected)[inside])
        assert left <= 1e-9 + 0.02 * size


@everyone
def test_needs_what_it_is_a_function_of(slug: str, state: State) -> None:
    effect = get_effect(slug)
    bare = replace(
        state,
        temperature=None,
        temperature_slope=None,
        vibration=None,
        mat_ns=None,
        since_turn=None,
        turning=None,
    )
    columns = effect.columns(bare, shape_of(effect))
    lacking = {
        *(s for s in CATALOGUE if "temperature" in s or "vibration" in s),
        "earth_rate",
        "reference_tilt",
        "reference_smoothing",
        "accel_settling",
    }
    assert (columns == {}) == (slug in lacking)


@everyone
def test_terms_are_checked(slug: str) -> None:
    with pytest.raises(ValueError, match="`nonsense` is no parameter"):
        SensorModel(terms=(Term(slug, {**values_of(get_effect(slug)), "nonsense": 1.0}),))
    needed = [p.name for p in get_effect(slug).shape if not p.optional]
    if needed:
        with pytest.raises(ValueError, match=f"needs `{needed[0]}`"):
            SensorModel(terms=(Term(slug, {}),))


@pytest.mark.parametrize("slug", sorted(effects()))
def test_no_term_of_a_sensor_is_of_any_size(slug: str) -> None:
    effect = get_effect(slug)
    names = [p.name for p in effect.parameters]
    least, most = effect.limits(names)
    typical = np.array([p.typical for p in effect.parameters])
    assert (least < most).all()
    assert (most > 1.4 * typical).all()
    physical = np.array([p.unit != PRESENCE and not p.refining for p in effect.parameters])
    if effect.kind == "sensor" and "vibration" not in effect.reads:
        assert np.isfinite([least[physical], most[physical]]).all()
    np.testing.assert_array_equal(effect.limits(names[::-1])[1], most[::-1])


def test_size_effect_is_the_difference_of_two_lever_arms(state: State) -> None:
    arm = {f"r{a}": v for a, v in zip(AXES, (0.004, -0.002, 0.003), strict=True)}
    whole = get_effect("accel_lever_arm").contribution(state, arm)
    apart = {f"ry{a}": v for a, v in zip(AXES, (0.004, -0.002, 0.003), strict=True)}
    part = get_effect("accel_size_effect").contribution(state, apart)
    assert set(part) == {"accel.y"}
    np.testing.assert_allclose(part["accel.y"], whole["accel.y"])


def test_lever_arm_is_the_acceleration_of_a_point_off_the_centre() -> None:
    """At a steady rate w about z, a point at x = r feels -w² r along x."""
    time = np.arange(0.0, 1.0, 0.01)
    rate = np.tile([0.0, 0.0, 5.0], (len(time), 1))
    found = get_effect("accel_lever_arm").contribution(
        State(time, np.zeros_like(rate), rate), {"rx": 0.1}
    )
    np.testing.assert_allclose(found["accel.x"], -2.5)
    np.testing.assert_allclose(found["accel.y"], 0.0, atol=1e-12)


def test_earth_rate_at_rest_is_the_same_vector_seen_from_each_pose(state: State) -> None:
    term = {"north": 4e-5, "up": 6e-5}
    seen = get_effect("earth_rate").contribution(state, term)
    in_s = np.stack([seen[f"gyro.{a}"] for a in AXES], axis=1)
    assert state.mat_ns is not None
    in_n = np.einsum("nij,nj->ni", state.mat_ns, in_s)
    np.testing.assert_allclose(in_n, np.tile([0, 4e-5, 6e-5], (len(in_n), 1)), atol=1e-12)


def test_earth_rate_by_latitude() -> None:
    from calib.effects.earth_rate import components

    assert components(0.0) == {"east": 0.0, "north": 7.292115e-5, "up": 0.0}
    south = components(np.radians(-30.0))
    assert south["up"] == pytest.approx(-0.5 * 7.292115e-5)
    assert np.degrees(south["north"]) * 3600 == pytest.approx(15.041 * np.cos(np.pi / 6), rel=1e-4)
    typical = get_effect("earth_rate").typical(span=(0.0, 1.0))
    assert np.linalg.norm(list(typical.values())) == pytest.approx(7.292115e-5)


def test_a_typical_low_pass_is_one_filter_for_each_triad() -> None:
    typical = get_effect("bandwidth").typical(span=(0.0, 1.0))
    assert set(typical) == {"accel_cutoff", "gyro_cutoff"}


def test_rate_of_temperature_is_fitted_through_its_noise() -> None:
    time = np.arange(0.0, 300.0, 0.01)
    noise = np.random.default_rng(3).normal(0, 0.03, len(time))
    state = State(
        time, np.zeros((len(time), 3)), np.zeros((len(time), 3)), 20 + 0.02 * time + noise
    )
    assert state.temperature_rate is not None
    assert np.abs(state.temperature_rate - 0.02).max() < 3e-3
    assert np.abs(state.temperature_rate[1500:-1500] - 0.02).max() < 8e-4


def smooth(time: np.ndarray) -> Signals:
    wave = np.stack([np.sin(2 * np.pi * f * time + p) for f, p in ((1, 0), (2, 1), (3, 2))], axis=1)
    return Signals(9.0 * wave, 2.0 * wave)


TIME = np.arange(0.0, 10.0, 0.01)
FINER = 40
"""Steps of another filter to one of ours."""


def transforms(slug: str) -> TransformEffect:
    effect = get_effect(slug)
    assert isinstance(effect, TransformEffect)
    return effect


def test_a_low_pass_of_both_triads_shows_as_amplitude_without_delay() -> None:
    time = np.arange(0.0, 4.0, 0.005)
    wave = np.sin(2 * np.pi * 2.0 * time)[:, None] * [1.0, 2.0, 3.0]
    column = get_effect("bandwidth").columns(State(time, wave, wave), {"both_cutoff": 8.0})["both"]
    w = 2.0 / 8.0
    delay = np.arctan(w) / (2 * np.pi * 2.0) - 1 / (2 * np.pi * 8.0)
    later = np.sin(2 * np.pi * 2.0 * (time - delay))
    expected = later / np.hypot(1.0, w) - wave[:, 0]
    middle = slice(200, 600)
    for c, size in zip(CHANNELS, (1, 2, 3) * 2, strict=True):
        assert np.abs(column[c][middle] - size * expected[middle]).max() < 2e-3 * size


@pytest.mark.parametrize("order", [1, 2])
def test_what_a_low_pass_takes_away_is_right_up_to_ends_in_motion(order: int) -> None:
    time = np.arange(0.0, 7.3, 0.01)
    turning = 2 * np.pi * 0.7
    wave = np.stack([np.sin(turning * time + phase) for phase in (0.3, 1.1, 2.0)], axis=1)
    shape = {"gyro_cutoff": 20.0, "order": float(order)}
    column = get_effect("bandwidth").columns(State(time, wave, wave), shape)["gyro"]
    s = 1j * 0.7 / 20.0
    gain = 1 / (1 + s) if order == 1 else 1 / (1 + np.sqrt(2) * s + s**2)
    for k, phase in enumerate((0.3, 1.1, 2.0)):
        true = np.imag(gain * np.exp(1j * (turning * time + phase))) - wave[:, k]
        # The first and the last samples are off by what nobody knows of the bend beyond them.
        np.testing.assert_allclose(column[f"gyro.{'xyz'[k]}"], true, atol=5e-3)
        np.testing.assert_allclose(column[f"gyro.{'xyz'[k]}"][10:-10], true[10:-10], atol=5e-4)


def test_a_low_pass_at_the_samples_is_what_firmware_makes_of_them_and_is_undone() -> None:
    effect, parameters = transforms("bandwidth"), {"gyro_cutoff": 8.0, "order": 0}
    rng = np.random.default_rng(3)
    true = Signals(rng.normal(size=(400, 3)), rng.normal(size=(400, 3)))
    time = TIME[:400]
    expected = [true.gyro[0]]
    for sample in true.gyro[1:]:
        expected.append(expected[-1] + (1.0 - np.exp(-0.16 * np.pi)) * (sample - expected[-1]))
    found = effect.transform(time, true, parameters)
    np.testing.assert_allclose(found.gyro, expected, atol=1e-12)
    np.testing.assert_array_equal(found.accel, true.accel)
    np.testing.assert_allclose(effect.inverse(time, found, parameters).gyro, true.gyro, atol=1e-12)
    assert effect.in_words(parameters)
    assert not effect.in_words({"gyro_cutoff": 8.0, "order": 1})


def test_what_a_low_pass_at_the_samples_takes_away_is_so_where_fewer_are_compared() -> None:
    time = np.arange(0.0, 8.0, 0.005)
    wave = np.sin(2 * np.pi * 1.5 * time)[:, None] * np.ones(3)
    shape = {"gyro_cutoff": 12.0, "order": 0.0}
    every = get_effect("bandwidth").columns(State(time, wave, wave), shape)["gyro"]["gyro.x"]
    passed = transforms("bandwidth").transform(time, Signals(wave, wave), {**shape, "gyro": 1.0})
    np.testing.assert_allclose(every[40:-40], (passed.gyro - wave)[40:-40, 0], atol=2e-4)
    fewer = State(time[::4], wave[::4], wave[::4], sampling=0.005)
    thin = get_effect("bandwidth").columns(fewer, shape)["gyro"]["gyro.x"]
    np.testing.assert_allclose(thin[20:-20], every[::4][20:-20], atol=2e-4)


@pytest.mark.parametrize("order", [0, 1, 2])
def test_what_a_low_pass_takes_away_goes_on_behind_a_gap(order: int) -> None:
    time = np.arange(0.0, 8.0, 0.005)
    wave = np.sin(2 * np.pi * 1.5 * time)[:, None] * np.ones(3)
    shape = {"gyro_cutoff": 12.0, "order": float(order)}
    every = get_effect("bandwidth").columns(State(time, wave, wave), shape)["gyro"]["gyro.x"]
    known = (time < 3.0) | (time > 3.2)
    rest = State(time[known], wave[known], wave[known], sampling=0.005)
    found = get_effect("bandwidth").columns(rest, shape)["gyro"]["gyro.x"]
    np.testing.assert_allclose(found, every[known], atol=5e-3)


def test_stamps_that_come_late_are_no_gap() -> None:
    time = np.arange(0.0, 8.0, 0.01)
    wave = np.sin(2 * np.pi * 1.5 * time)[:, None] * np.ones(3)
    late = time.copy()
    late[200::100] += 0.007
    shape = {"gyro_cutoff": 12.0}
    prompt, stamped = (
        get_effect("bandwidth").columns(State(t, wave, wave), shape)["gyro"]["gyro.x"]
        for t in (time, late)
    )
    np.testing.assert_array_equal(stamped, prompt)


@pytest.mark.parametrize("order", [0, 1, 2])
@pytest.mark.parametrize("delay", [1e-4, 2e-3, 0.03])
def test_a_cut_off_is_known_from_the_delay_that_it_makes(order: int, delay: float) -> None:
    cutoff = cutoff_of(delay, order, 0.005)
    assert group_delay(cutoff, order, 0.005) == pytest.approx(delay)
    if order == 0:
        # Of a ramp the samples of such a filter are late by this much once it has settled.
        time = np.arange(0.0, 2.0, 0.005)
        passed = low_pass(time, time[:, None], cutoff, order=0)
        assert time[-1] - passed[-1, 0] == pytest.approx(delay, rel=1e-6)


@pytest.mark.parametrize("order", [1, 2])
def test_bandwidth_has_the_gain_of_its_filter_and_is_undone(order: int) -> None:
    effect, parameters = transforms("bandwidth"), {"gyro_cutoff": 8.0, "order": order}
    frequency = 5.0
    true = np.sin(2 * np.pi * frequency * TIME)[:, None] * np.ones(3)
    found = effect.transform(TIME, Signals(true, true), parameters)
    np.testing.assert_array_equal(found.accel, true)
    s = 1j * frequency / 8.0
    gain = 1 / (1 + s) if order == 1 else 1 / (1 + np.sqrt(2) * s + s * s)
    expected = np.imag(gain * np.exp(2j * np.pi * frequency * TIME))
    np.testing.assert_allclose(found.gyro[200:, 0], expected[200:], atol=2e-3)
    back = effect.inverse(TIME, found, parameters)
    np.testing.assert_allclose(back.gyro[200:-50], true[200:-50], atol=0.02)


@pytest.mark.parametrize("order", [0, 1, 2])
@pytest.mark.parametrize("triads", [("gyro",), ("both",)])
def test_bandwidth_is_undone_without_blowing_up_noise(order: int, triads: tuple[str, ...]) -> None:
    effect = transforms("bandwidth")
    parameters = {**{f"{t}_cutoff": 5.0 for t in triads}, "order": order}
    # A turn with a hand's tremor, between rests.
    u = np.clip((TIME - 2.0) / 1.5, 0, 1)
    hump = (16 * u**2 * (1 - u) ** 2)[:, None]
    true = hump * (3.0 + 0.3 * np.sin(2 * np.pi * 7.0 * TIME)[:, None]) * [1.0, -0.5, 0.2]
    noise = 0.01 * np.random.default_rng(order or 3).normal(size=true.shape)
    seen = effect.transform(TIME, Signals(true, true), parameters)
    noisy = Signals(seen.accel + noise, seen.gyro + noise)
    back = effect.restorer(noisy, interval=0.01)(parameters)
    left = back.gyro - true
    # No wave grows to more than 1 / (2 GONE) = 10 times what it was.
    assert np.sqrt(np.mean(left**2)) < 10 * 0.01
    assert np.abs(left.mean(axis=0)).max() < 1e-3
    smooth_left = effect.restorer(seen, interval=0.01)(parameters).gyro - true
    assert np.abs(smooth_left).max() < 0.015
    if triads == ("gyro",):
        np.testing.assert_array_equal(back.accel, seen.accel + noise)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("samples", [2, 3, 400])
def test_bandwidth_agrees_with_another_filter(order: int, samples: int) -> None:
    rng = np.random.default_rng(samples)
    time, values = 0.01 * np.arange(samples), rng.normal(size=(samples, 3)).cumsum(axis=0)
    bends = CubicSpline(time, values)
    if samples < 4:
        bends = CubicHermiteSpline(time, values, np.gradient(values, time, axis=0))
    finer = bends(0.01 / FINER * np.arange((samples - 1) * FINER + 1))
    for cutoff in (1.0, 20.0, 200.0):
        w0 = 2 * np.pi * cutoff
        analogue = [1 / w0, 1.0] if order == 1 else [1 / w0**2, np.sqrt(2) / w0, 1.0]
        num, den, _ = signal.cont2discrete(([1.0], analogue), 0.01 / FINER, method="foh")
        start = signal.lfilter_zi(num.ravel(), den)[:, None] * values[0]
        expected = signal.lfilter(num.ravel(), den, finer, axis=0, zi=start)[0][::FINER]
        found = low_pass(time, values, cutoff, order=order)
        np.testing.assert_allclose(found, expected, atol=1e-3)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("cutoff", [5.0, 25.0, 150.0])
def test_a_low_pass_beyond_half_the_sample_rate_is_as_exact(order: int, cutoff: float) -> None:
    time = 0.02 * np.arange(2000)
    for frequency in (1.0, 5.0):
        wave = np.exp(2j * np.pi * frequency * time)
        passed = low_pass(time, np.stack((wave.real, wave.imag), axis=1), cutoff, order=order)
        s = 1j * frequency / cutoff
        response = 1 / (1 + s) if order == 1 else 1 / (1 + np.sqrt(2) * s + s**2)
        inner = slice(500, 1500)
        error = np.abs((passed[:, 0] + 1j * passed[:, 1])[inner] - response * wave[inner])
        assert error.max() < 2e-3 * abs(response - 1)


def test_saturation_cuts_and_keeps_the_rest() -> None:
    found = transforms("saturation").transform(TIME, smooth(TIME), {"gyro_full_scale": 1.0})
    assert np.abs(found.gyro).max() == 1.0
    kept = np.abs(smooth(TIME).gyro) < 1.0
    np.testing.assert_array_equal(found.gyro[kept], smooth(TIME).gyro[kept])
    np.testing.assert_array_equal(found.accel, smooth(TIME).accel)


def test_quantization_rounds_to_whole_counts() -> None:
    found = transforms("quantization").transform(TIME, smooth(TIME), {"accel_lsb": 0.25})
    np.testing.assert_array_equal(found.accel % 0.25, 0.0)
    assert np.abs(found.accel - smooth(TIME).accel).max() <= 0.125


@pytest.mark.parametrize("count", [1, 3, -2])
def test_dropped_samples_move_the_rest_and_are_put_back(count: int) -> None:
    effect, parameters = transforms("dropped_samples"), {"count": count, "moment": 4.0}
    true = smooth(TIME)
    found = effect.transform(TIME, true, parameters)
    np.testing.assert_allclose(found.gyro[:400], true.gyro[:400], atol=1e-12)
    np.testing.assert_array_equal(found.gyro[410:900], true.gyro[410 + count : 900 + count])
    back = effect.inverse(TIME, found, parameters)
    np.testing.assert_allclose(back.gyro[:900], true.gyro[:900], atol=5e-3)


def test_a_dropped_sample_costs_one_step_of_angle() -> None:
    effect, true = transforms("dropped_samples"), smooth(TIME)
    column = effect.columns(State(TIME, *true), {"moment": 4.0})["count"]["gyro.x"]
    k = int(np.argmax(TIME >= 4.0))
    lost = np.trapezoid(column, TIME)
    assert lost == pytest.approx(0.01 * (true.gyro[-1, 0] - true.gyro[k, 0]), abs=1e-3)


def test_clock_scale_stretches_time_from_the_first_sample() -> None:
    found = transforms("clock_scale").transform(TIME, smooth(TIME), {"scale": 0.01})
    at = TIME / 1.01
    np.testing.assert_allclose(found.gyro[:-200], smooth(at).gyro[:-200], atol=1e-5)


def test_time_offset_delays_the_gyro() -> None:
    found = transforms("time_offset").transform(TIME, smooth(TIME), {"gyro_delay": 0.004})
    expected = smooth(TIME - 0.004).gyro
    np.testing.assert_allclose(found.gyro[20:-50], expected[20:-50], atol=1e-5)
    np.testing.assert_array_equal(found.accel, smooth(TIME).accel)


def test_axis_orders_are_all_different_and_named() -> None:
    from calib.effects.axis_error import ORDERS, describe_order, signed_permutation

    matrices = {signed_permutation(k).tobytes() for k in range(len(ORDERS))}
    assert len(matrices) == 48
    np.testing.assert_array_equal(signed_permutation(0), np.eye(3))
    number = next(k for k in range(48) if describe_order(k) == "x: -y, y: x, z: z")
    np.testing.assert_array_equal(signed_permutation(number) @ [1.0, 2.0, 3.0], [-2.0, 1.0, 3.0])
    with pytest.raises(ValueError, match="`gyro_axes`"):
        SensorModel(terms=(Term("axis_error", {"gyro_axes": 48}),))


def test_a_unit_is_no_factor_of_zero() -> None:
    with pytest.raises(ValueError, match="`accel` of unit_error"):
        SensorModel(terms=(Term("unit_error", {"accel": -1.0}),))


@everyone
def test_says_what_it_reads(slug: str, state: State) -> None:
    """Without a field that it reads it has no columns; without the others it has."""
    effect = get_effect(slug)
    optional = ("temperature", "vibration", "since_turn", "turning", "mat_ns")
    assert set(effect.reads) <= set(optional)
    for name in optional:
        lacking = replace(state, temperature_slope=None, **{name: None})
        assert (effect.columns(lacking, shape_of(effect)) == {}) == (name in effect.reads)


def test_settling_has_a_form_for_what_there_is_in_turns(state: State) -> None:
    effect = get_effect("accel_settling")
    of = {
        form: effect.columns(state, {"tau": 2.0, "in_turns": form})["kx"]["accel.x"]
        for form in (FADING, WHOLE, NONE)
    }
    rest = ~state.turning
    assert rest.any()
    assert not rest.all()
    for column in of.values():
        np.testing.assert_array_equal(column[rest], np.exp(-state.since_turn[rest] / 2.0))
    np.testing.assert_array_equal(of[WHOLE][state.turning], 1.0)
    np.testing.assert_array_equal(of[NONE][state.turning], 0.0)
    fading = np.exp(-state.since_turn[state.turning] / 2.0)
    np.testing.assert_array_equal(of[FADING][state.turning], fading)
    # As it was before there were forms.
    plain = effect.columns(state, {"tau": 2.0})["kx"]["accel.x"]
    np.testing.assert_array_equal(plain, of[FADING])
    words = {effect.in_words({"tau": 2.0, "in_turns": form}) for form in of}
    assert len(words) == 3


@pytest.mark.parametrize("value", [-1, 3, 1.5])
def test_a_form_is_one_of_those_that_there_are(value: float) -> None:
    with pytest.raises(ValueError, match="`in_turns` of accel_settling must be 0 to 2"):
        SensorModel(terms=(Term("accel_settling", {"tau": 1.0, "in_turns": value}),))


@pytest.mark.parametrize(
    ("slug", "values", "said"),
    [
        ("accel_warm_up", {"kx": 0.05, "tau": -60.0}, r"`tau` of .* above 0 s, got -60"),
        ("accel_settling", {"kx": 0.05, "tau": 0.0}, r"`tau` of .* above 0 s, got 0"),
        ("saturation", {"gyro_full_scale": -1.0}, r"`gyro_full_scale` .* above 0 rad/s, got -1"),
        ("quantization", {"gyro_lsb": 0.0}, r"`gyro_lsb` .* above 0 rad/s, got 0"),
        ("bandwidth", {"gyro_cutoff": -5.0}, r"`gyro_cutoff` .* above 0 Hz, got -5"),
        ("bandwidth", {"accel_cutoff": 0.0}, r"`accel_cutoff` .* above 0 Hz, got 0"),
        ("bandwidth", {"order": 2.0}, "has no size: give `accel_cutoff` or `gyro_cutoff` or `both"),
        ("saturation", {"gyro": 1.0}, "`gyro` of .* is 1 and has no size: give `gyro_full_scale`"),
        ("saturation", {"gyro": 1.0, "accel_full_scale": 9.0}, "`gyro` of .* has no size"),
        ("axis_error", {"accel": 1.0}, "give `accel_axes`"),
        ("clock_scale", {"scale": -1.0}, "`scale` of clock_scale must be above -1, got -1"),
    ],
)
def test_what_cannot_be_is_refused(slug: str, values: dict[str, float], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        SensorModel(terms=(Term(slug, values),))
    text = ",".join(f"{name}={value}" for name, value in values.items())
    with pytest.raises(ValueError, match=said):
        parse_term(f"{slug}:{text}", span=(0.0, 60.0))


@pytest.mark.parametrize("slug", ["dropped_samples", "gyro_bias_step", "accel_bias_step"])
def test_a_moment_is_in_the_recording(slug: str) -> None:
    for moment in (-1.0, 20.5):
        with pytest.raises(ValueError, match=f"`moment` of {slug} .* 0 to 20 s, got {moment:g}"):
            parse_term(f"{slug}:moment={moment}", span=(0.0, 20.0))
    assert parse_term(f"{slug}:moment=20", span=(0.0, 20.0)).parameters["moment"] == 20.0


@pytest.mark.parametrize(
    ("slug", "form"),
    [
        *(("accel_settling", {"in_turns": form}) for form in (FADING, WHOLE, NONE)),
        ("gyro_vibration_rectification", {}),
    ],
)
def test_correct_finds_what_nobody_states(slug: str, form: dict[str, float]) -> None:
    """`apply` knows only the signals: the correction must still take most of the effect away."""
    motion = bench_protocol(np.random.default_rng(6), poses=10, vibration=3.0)
    effect = get_effect(slug)
    values = {p.name: 20 * p.typical for p in effect.parameters}
    values |= {p.name: 2.0 for p in effect.shape} | form
    model = SensorModel(terms=(Term(slug, values),))
    quiet = NoiseModel()
    with_effect, without = (
        simulate(motion, m, quiet, rng=np.random.default_rng(0), rate=100.0)
        for m in (model, SensorModel())
    )
    measured = State(with_effect.time, with_effect.accel, with_effect.gyro)
    found = stacked(model.correct(measured))
    before = stacked(Signals(with_effect.accel, with_effect.gyro))
    for channel, true in stacked(Signals(without.accel, without.gyro)).items():
        size = rms(before[channel] - true)
        assert rms(found[channel] - true) <= 0.35 * size + 1e-9


@pytest.mark.parametrize(
    "slug", [slug for slug in CATALOGUE if slug not in ("clock_scale", "dropped_samples")]
)
def test_reach_covers_what_the_correction_looks_at(slug: str, state: State) -> None:
    """Changing a sample changes corrected samples only within reach."""
    effect = get_effect(slug)
    model = SensorModel(terms=(Term(slug, values_of(effect)),))
    n, k = 6000, 3000
    measured = State(
        state.time[:n], state.force[:n], state.rate[:n], temperature=25 + state.time[:n] / 10
    )
    reach = effect.reach(values_of(effect), interval=0.0025)
    first = model.correct(measured)
    bumped = {
        "force": measured.force + np.where(np.arange(n) == k, 0.1, 0.0)[:, None],
        "temperature": measured.temperature + np.where(np.arange(n) == k, 0.1, 0.0),
    }
    second = model.correct(replace(measured, **bumped))
    moved = np.flatnonzero(
        (np.abs(first.accel - second.accel).max(axis=1) > 1e-9)
        | (np.abs(first.gyro - second.gyro).max(axis=1) > 1e-9)
    )
    assert len(moved)
    assert k - moved.min() <= reach
    assert moved.max() - k <= max(reach, effect.memory(values_of(effect), interval=0.0025))


def test_an_earth_is_no_faster_than_it_turns() -> None:
    from calib.effects.earth_rate import RATE, components

    earth = get_effect("earth_rate")
    known = components(np.radians(48.0))
    error = dict.fromkeys(known, 1e-6)
    assert earth.excess(known, error) == 1.0  # type: ignore[attr-defined]
    for times in (2.0, 27.0):
        up = {**known, "up": times * RATE}
        assert earth.excess(up, error) == pytest.approx(  # type: ignore[attr-defined]
            np.linalg.norm(list(up.values())) / RATE
        )
        # Nor is it where nobody knows.
        vague = {**error, "up": 0.4 * times * RATE}
        assert earth.excess(up, vague) == 1.0  # type: ignore[attr-defined]


def test_an_earth_is_no_slower_than_it_turns() -> None:
    from calib.effects.earth_rate import RATE, components

    earth = get_effect("earth_rate")
    known = np.array(list(components(np.radians(-48.0)).values()))
    exact, vague = np.eye(3) * 1e-6**2, np.diag([RATE, RATE, 1e-6]) ** 2
    assert not earth.too_small(known, exact)
    # A heading that drifted halves the part north of it at most.
    assert not earth.too_small(known * [1.0, 0.5, 1.0], exact)
    up = np.array([0.0, 0.0, 0.1 * RATE])
    assert earth.too_small(up, exact)
    assert not earth.too_small(up, vague)
    assert not any(
        effect.too_small(np.zeros(len(effect.parameters)), np.zeros((0, 0)))
        for slug, effect in effects().items()
        if slug != "earth_rate"
    )


def test_forms_that_no_recording_tells_apart_are_not_both_tried() -> None:
    effect = get_effect("bandwidth")
    assert effect.is_form({"gyro_cutoff": 8.0, "order": 0.0})
    assert not effect.is_form({"both_cutoff": 8.0, "order": 0.0})
    assert [own["order"] for own in forms(effect, {"both_cutoff": 8.0, "order": 2.0})] == [2.0, 1.0]
    time = np.arange(0.0, 8.0, 0.005)
    wave = np.sin(2 * np.pi * 1.5 * time)[:, None] * np.ones(3)
    state = State(time, wave, wave)
    one, other = (
        effect.columns(state, {"both_cutoff": 8.0, "order": order})["both"]["gyro.x"][200:-200]
        for order in (0.0, 1.0)
    )
    assert np.abs(one - other).max() < 0.01 * np.abs(one).max()
