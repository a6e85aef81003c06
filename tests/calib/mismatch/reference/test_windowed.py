"""Windows of differences: the blur, and rows where the truth errs with the motion."""

import numpy as np
import pytest

from calib.effects.base import State
from calib.errors import NoCommonMotionError
from calib.mismatch.hypotheses.candidates import Candidate
from calib.mismatch.noise.contrast import contrast_variance
from calib.mismatch.reference import shapes
from calib.mismatch.reference.band import limited, widened
from calib.mismatch.reference.colour import Blur, find_colour, gaussian, whitening
from calib.mismatch.reference.filters import low_passed, smoothed
from calib.mismatch.reference.scatter import NOTHING_SAID, silenced
from calib.mismatch.reference.shapes import find_shapes
from calib.mismatch.reference.truths import ENDS, RecordingTruth
from calib.mismatch.reference.windowed import make_rows
from calib.mismatch.rows.rows import Kind, Rows
from calib.mismatch.search.accepted import Accepted
from calib.mismatch.search.joint import cut
from calib.recording import CHANNELS, Recording

STEP = 0.02


def test_a_blur_passes_slow_signals_and_skips_what_is_near_a_gap():
    time = np.delete(STEP * np.arange(500), np.arange(200, 210))
    blur = gaussian(time, 2.0 * STEP, STEP)
    seen = time[blur.seen]
    slow = np.sin(2 * np.pi * 1.0 * time)
    damped = np.exp(-0.5 * np.square(2 * np.pi * 2.0 * STEP))
    assert np.allclose(blur.matrices[0] @ slow, damped * np.sin(2 * np.pi * seen), atol=1e-3)
    assert not ((seen > 193.5 * STEP) & (seen < 215.5 * STEP)).any()
    noise = np.random.default_rng(1).normal(size=(len(time), 400))
    assert np.isclose((blur.matrices[1] @ noise).var(), blur.power[1], rtol=0.02)


def test_no_blur_leaves_every_point():
    blur = gaussian(STEP * np.arange(50), 0.0, STEP)
    assert len(blur.seen) == 50
    assert blur.power == (1.0, 1.0)


def rows_of(
    left: np.ndarray,
    *,
    width: float = 0.0,
    aligned: tuple[str, ...] = (),
    step: float = STEP,
    blur: Blur | None = None,
) -> Rows:
    time = step * np.arange(len(left))
    blur = gaussian(time, width, STEP) if blur is None else blur
    rate = np.stack([np.sin(2 * np.pi * f * time) for f in (0.5, 0.7, 1.1)], axis=1)
    state = State(time, np.tile([0.0, 0.0, 9.8], (len(time), 1)), rate)
    columns = [(c, rate[:, i % 3]) for i, c in enumerate(CHANNELS)]
    return make_rows(
        find_shapes(time, left, blur.see_columns(columns), blur=blur),
        state,
        left,
        names=("gyro.bias.x",),
        nuisance=[{"gyro.x": np.ones(len(time))}],
        aligned=aligned,
        prior=np.array([[0.0, 2.0], [0.0, 0.1]]),
    )


@pytest.mark.parametrize("rate", [5.0, 8.0, 10.0, 12.5, 100.0])
def test_windows_of_slow_samples_are_longer(rate: float) -> None:
    first, last = shapes.cut(np.arange(int(20.0 * rate)) / rate)
    assert (last - first).min() >= shapes.FEWEST
    assert first[0] == 0
    assert last[-1] == int(20.0 * rate)
    assert np.median(last - first) <= max(1.1 * rate, 1.5 * shapes.FEWEST)
    with pytest.raises(NoCommonMotionError, match="torn by gaps"):
        shapes.cut(np.arange(shapes.FEWEST - 1) / rate)


def test_windows_end_in_rests_where_there_are_some():
    time = STEP * np.arange(12000)
    # Rests of 5 s, and turns of 3 s, with nothing to go by at the end.
    start = np.arange(0.5, 0.8 * time[-1], 8.0)
    still = np.stack((start, start + 5.0), axis=1)
    first, last = shapes.cut(time, None, still)
    assert first[0] == 0
    assert last[-1] == len(time)
    assert (first[1:] == last[:-1]).all()
    assert (last - first >= shapes.FEWEST).all()
    at = time[first[1:]]
    known = at < still[-1, 1]
    inside = ((at[:, None] >= still[:, 0] - STEP) & (at[:, None] <= still[:, 1] + STEP)).any(axis=1)
    assert inside[known].all()
    assert (~known).sum() > 5
    plain, _ = shapes.cut(time)
    assert 0.6 * len(plain) < len(first) <= len(plain) + 1
    # Rests that begin where the recording ends, or outside of it, are no ends of windows.
    edge = np.array([[-9.0, -5.0], [time[-1] - 0.05, time[-1] + 4.0]])
    first, last = shapes.cut(time, None, edge)
    assert (last - first >= shapes.FEWEST).all()
    assert last[-1] == len(time)


def test_white_noise_has_the_variance_that_rows_say_blurred_or_not():
    rng = np.random.default_rng(2)
    for width in (0.0, 1.5 * STEP):
        rows = rows_of(rng.normal(size=(16000, 6)), width=width)
        variance = np.append(np.diag(rows.white), rows.white_diagonal)
        for kind in (Kind.MEAN, Kind.CONTRAST):
            own = rows.kind == kind
            assert np.isclose(np.mean(rows.residual[own] ** 2 / variance[own]), 1.0, atol=0.2)


def test_the_noise_of_windows_of_few_points_is_not_taken_for_less():
    """The median of squares is below their mean: of ten points by 7 %."""
    rng, time = np.random.default_rng(11), 0.1 * np.arange(12 * 80)
    columns, blur = [(c, np.sin(time)) for c in CHANNELS], gaussian(time, 0.0, 0.1)
    found = []
    for _ in range(10):
        left = rng.normal(size=(len(time), 6))
        shapes = find_shapes(time, left, blur.see_columns(columns), blur=blur)
        found.append(np.median(shapes.noise, axis=0))
    assert np.mean(found) == pytest.approx(1.0, abs=0.03)


def test_where_the_truth_errs_rows_are_restless_and_a_knock_weighs_little():
    rng = np.random.default_rng(3)
    left = rng.normal(size=(16000, 6))
    left[12800:] *= 30.0
    plain = contrast_variance(rows_of(left))
    # One knock that has the shape of the motion: no noise of samples tells of it.
    time = STEP * np.arange(len(left))
    window = (time >= 264.0) & (time < 268.0)
    left[window, 3] += 400.0 * np.sin(2 * np.pi * 0.5 * time[window])
    rows = rows_of(left)
    assert 0 < rows.restless.sum() < 0.5 * len(rows.restless)
    assert rows.interval[rows.segment[rows.restless], 1].min() > 250.0
    contrast = rows.segment[rows.n_dense :], rows.channel[rows.n_dense :]
    hit = (contrast[0] == int(266.0 // (320.0 / 80))) & (contrast[1] == 3)
    assert hit.any()
    assert (contrast_variance(rows)[hit] > 4 * plain[hit]).all()


def accepted(name: str, *, physical: bool = False, interval=None) -> Accepted:
    candidate = Candidate(name, np.arange(2), 0.1, physical, ("gyro.x",), interval=interval)
    return Accepted(candidate, np.ones((1, 2)), np.ones(2), np.zeros(2), False, 1.0)


def test_smooth_rivals_move_no_physics_beside_a_reference_and_windows_do():
    found = (
        accepted("direction of gravity"),
        accepted("bias in a window", interval=(0.0, 1.0)),
        accepted("accel_lever_arm", physical=True),
    )
    left = np.random.default_rng(4).normal(size=(1000, 6))
    beside = cut(rows_of(left, aligned=("time_offset.delay",)), found)
    assert beside.tolist() == [False, False, True, True, False, False, False, False]
    assert not cut(rows_of(left), found).any()


def test_a_truth_is_not_believed_beside_a_spoilt_sample():
    time = STEP * np.arange(100)
    signals = np.stack([np.sin(time + k) for k in range(6)], axis=1)
    spoilt = np.arange(100) == 50
    truth = RecordingTruth(Recording(time, signals[:, :3], signals[:, 3:], "device"), 9.8, spoilt)
    known = truth.covers(time)
    assert not known[48:53].any()
    assert known[ENDS:48].all()
    assert known[54:-ENDS].all()
    assert not known[: ENDS - 1].any()


@pytest.mark.parametrize("derivative", [0, 1, 2])
def test_what_a_low_pass_leaves_of_noise_has_the_variance_that_rows_say(derivative):
    """Noise of rates is that of angles times frequency, of accelerations of its square."""
    rng = np.random.default_rng(5)
    n, band = 40000, 5.0
    spectrum = np.fft.rfft(rng.normal(size=(n, 6)), axis=0)
    frequency = np.fft.rfftfreq(n, STEP)
    spectrum *= np.sqrt(1.0 + (frequency[:, None] / 1.5) ** (2 * derivative))
    noise = np.fft.irfft(spectrum, n, axis=0)
    raw = Recording(STEP * np.arange(n), noise[:, :3], noise[:, 3:], "device")
    common = limited(raw, RecordingTruth(raw, 9.8), band, np.zeros(n, bool))
    left, time = np.hstack((common.real.accel, common.real.gyro)), common.real.time
    colours = [find_colour(time, left[:, a : a + 3], common.real.interval, band) for a in (0, 3)]
    blur = whitening(time, colours, common.real.interval, common.bands)
    rows = rows_of(left, step=common.real.interval, blur=blur)
    variance = np.append(np.diag(rows.white), rows.white_diagonal)
    for kind in (Kind.MEAN, Kind.CONTRAST):
        own = rows.kind == kind
        assert np.isclose(np.mean(rows.residual[own] ** 2 / variance[own]), 1.0, atol=0.25)
    assert (colours[0].at(np.array([band])) > 5.0) == (derivative > 0)


def test_noise_rises_no_more_steeply_than_turns_allow():
    rng = np.random.default_rng(6)
    time = STEP * np.arange(20000)
    angle = smoothed(STEP * np.arange(20000), rng.normal(size=(20000, 3)), 5.0)
    rate = np.gradient(angle, STEP, axis=0)
    free = find_colour(time, rate, STEP, 5.0)
    bound = find_colour(time, rate, STEP, 5.0, steepest=0.5)
    assert free.square > 1.0
    assert bound.square == pytest.approx(0.5)
    assert bound.fourth < 0.1


def test_a_low_pass_is_the_same_at_any_rate():
    for rate in (50.0, 64.0, 286.0):
        time = np.arange(0.0, 20.0, 1 / rate)
        wave = np.sin(2 * np.pi * 9.0 * time)[:, None]
        middle = (time > 5.0) & (time < 15.0)
        expected = wave / (1 + (9.0 / 6.0) ** 8)
        assert np.allclose(smoothed(time, wave, 6.0)[middle], expected[middle], atol=2e-4)
        slow = np.stack((time, np.sin(0.5 * time)), axis=1)
        assert np.allclose(smoothed(time, slow, 6.0)[middle], slow[middle], atol=1e-3)


def test_a_low_pass_bridges_a_gap_and_says_where_it_is_not_to_be_believed():
    time = np.delete(STEP * np.arange(1000), np.arange(400, 420))
    slow = np.sin(2 * np.pi * 0.3 * time[:, None] + np.arange(6))
    recording = Recording(time, slow[:, :3], slow[:, 3:], "device")
    passed = low_passed(recording, 5.0)
    bad = widened(recording, 5.0, np.arange(980) == 200)
    reach = 2.0 / 5.0
    for moment in (time[0], time[-1], time[200], time[399], time[400]):
        assert bad[np.abs(time - moment) < reach - STEP].all()
    assert bad.mean() < 0.15
    assert np.allclose(passed.accel[~bad], recording.accel[~bad], atol=1e-3)
    assert np.abs(passed.gyro - recording.gyro).max() < 1.0


def test_a_window_that_says_nothing_has_no_say_in_the_noise():
    rng = np.random.default_rng(1)
    time = np.arange(0.0, 60.0, 0.05)
    left = rng.normal(0, 0.1, (len(time), 6))
    columns, blur = [(name, np.sin(time)) for name in CHANNELS], gaussian(time, 0.0, 0.05)
    views = blur.see_columns(columns)
    found = find_shapes(time, left, views, blur=blur, scatter=silenced(time < 5.0))
    assert np.isfinite(found.noise).all()
    np.testing.assert_allclose(found.noise[0] / found.noise[-1], NOTHING_SAID, rtol=1e-6)


def test_rows_go_to_what_hardly_shows_and_not_to_what_is_plain_without_them(monkeypatch):
    rng = np.random.default_rng(2)
    time = np.arange(0.0, 60.0, 0.05)
    left = rng.normal(0, 0.1, (len(time), 6))
    strong = 50.0 * np.stack([np.sin((3 + k) * time) for k in range(6)])
    weak = 0.05 * np.cos(1.7 * time)
    columns = [(name, values) for name in CHANNELS for values in (*strong, weak)]
    blur = gaussian(time, 0.0, 0.05)

    def kept() -> float:
        found = find_shapes(time, left, blur.see_columns(columns), blur=blur)
        windows = zip(found.first[found.segment], found.last[found.segment], strict=True)
        parts = [weak[a:b] for a, b in windows]
        return sum(float(x @ v) ** 2 for x, v in zip(parts, found.vectors, strict=True))

    monkeypatch.setattr(shapes, "SHAPES", 900)
    found = find_shapes(time, left, blur.see_columns(columns), blur=blur)
    whole = sum(
        float(np.var(weak[a:b]) * (b - a)) for a, b in zip(found.first, found.last, strict=True)
    )
    told = kept()
    assert told > 0.25 * whole
    monkeypatch.setattr(shapes, "ENOUGH", 1e9)
    assert told > kept()


def test_an_accelerometer_that_is_judged_in_parts_may_have_samples_that_say_nothing():
    rng = np.random.default_rng(8)
    time = 0.05 * np.arange(600)
    left = rng.normal(size=(600, 6))
    columns = [(c, np.sin(time + i)) for i, c in enumerate(CHANNELS)]
    # In one stretch, and where rests are of one sample.
    for judged in (time < 12.0, np.arange(600) % 40 == 0):
        blur = gaussian(time, 0.0, 0.05).judging(judged)
        found = find_shapes(
            time, left, blur.see_columns(columns), blur=blur, scatter=silenced(time < 2.0)
        )
        assert np.isfinite(found.noise).all()
        assert all(np.isfinite(vector).all() for vector in found.vectors)
