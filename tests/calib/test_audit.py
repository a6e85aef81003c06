"""Each fault is found and said, on its channel and at its time; sound logs have no findings."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import median_filter

from calib import DeviceInfo, Recording, SensorModel, Triad
from calib.audit import Finding, audit, check_units
from calib.effects.base import State
from calib.errors import UnitError
from calib.faults import (
    find_clipping,
    find_copies,
    find_gaps,
    find_limits,
    find_spikes,
    find_stuck,
    resolution,
    values_of,
)
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import CONSUMER
from drivers.formats import read_recording

ROOT = Path(__file__).resolve().parents[2]
RNG = np.random.default_rng


@cache
def bench() -> Recording:
    return read_recording(ROOT / "fixtures" / "bench.csv")


def changed(channel: int, rows: slice | np.ndarray, change: Callable[..., object]) -> Recording:
    values = values_of(bench()).copy()
    values[rows, channel] = change(values[rows, channel])
    return replace(bench(), accel=values[:, :3], gyro=values[:, 3:])


def the_finding(recording: Recording) -> Finding:
    findings = audit(recording).findings
    assert len(findings) == 1, findings
    return findings[0]


def test_a_sound_log_has_no_findings() -> None:
    result = audit(bench())
    assert result.findings == ()
    assert (result.samples, len(result.poses), result.rate) == (9786, 20, pytest.approx(100))
    assert result.distinct_poses >= 9
    assert result.complete


def test_a_gap_is_measured_and_timed() -> None:
    b = bench()
    keep = np.r_[:4000, 4025:6000, 6001 : len(b)]
    assert b.temperature is not None
    recording = replace(
        b,
        time=b.time[keep],
        accel=b.accel[keep],
        gyro=b.gyro[keep],
        temperature=b.temperature[keep],
        lost=None,
    )
    finding = the_finding(recording)
    assert (finding.kind, finding.count) == ("gaps", 26)
    assert finding.times == (pytest.approx(40.25), pytest.approx(60.01))
    assert "26 of them were not counted" in finding.message


@given(st.lists(st.integers(1, 40), min_size=3, max_size=60), st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_gaps_count_what_was_removed(steps: list[int], seed: int) -> None:
    # Most steps are one interval, so that the median is.
    steps = [step for gap in steps for step in (1, 1, gap)]
    time = np.cumsum([0, *steps]) * 0.01
    n = len(time)
    values = RNG(seed).normal(size=(n, 3))
    gaps = find_gaps(Recording(time=time, accel=values, gyro=values, clock="device"))
    assert gaps.missing.sum() == sum(steps) - len(steps)


def test_jitter_and_repeats_and_rate() -> None:
    b = bench()
    shaken = replace(b, time=b.time + RNG(0).uniform(-0.0015, 0.0015, len(b)))
    assert the_finding(shaken).kind == "jitter"
    values = values_of(b).copy()
    for k in range(500, 9000, 800):
        values[k] = values[k - 1]
    finding = the_finding(replace(b, accel=values[:, :3], gyro=values[:, 3:]))
    assert (finding.kind, finding.count) == ("repeats", 11)
    assert finding.times[0] == pytest.approx(5.0)
    late = replace(b, time=b.time * 1000, temperature=None)
    assert "rate" in {found.kind for found in audit(late).findings}


def test_a_coarse_channel_between_two_counts_is_not_stuck_while_others_move() -> None:
    noise = 0.2 * RNG(1).normal(0, 1, (20_000, 6))
    moving = np.arange(20_000) % 1000 >= 800
    # In a few rests it is near the edge of a count, and not in a turn about another axis.
    at = np.where(np.arange(20_000) // 1000 % 3 == 1, 0.1, 0.4)
    values = noise + at[:, None]
    values[:, 1:] += np.where(moving, 30 * np.sin(np.arange(20_000) / 30), 0.0)[:, None]
    values[:, 0] += np.where(moving & (at > 0.2), 30 * np.sin(np.arange(20_000) / 20), 0.0)
    coarse = np.round(values)
    none = np.zeros(coarse.shape, bool)
    assert not find_stuck(coarse, moving, interval=0.01, clipped=none)
    coarse[4500:8200, 3] = coarse[4500, 3]
    assert [c for c, *_ in find_stuck(coarse, moving, interval=0.01, clipped=none)] == [3]


@pytest.mark.parametrize("sigma", [0.15, 0.3, 0.6, 0.9, 1.1, 3.0])
def test_counts_of_any_noise_are_not_stuck_where_one_channel_turns(sigma: float) -> None:
    moving = np.arange(20_000) % 1000 >= 800
    values = sigma * RNG(1).normal(0, 1, (20_000, 6)) + 0.1 * np.arange(6)
    values[:, 1] += np.where(moving, 30 * np.sin(np.arange(20_000) / 30), 0.0)
    none = np.zeros(values.shape, bool)
    assert not find_stuck(np.round(values), moving, interval=0.01, clipped=none)


def test_a_log_that_moves_nearly_throughout_is_not_stuck_in_its_few_rests() -> None:
    """Neighbours are equal in one of four there, and hardly ever while it moves."""
    values = np.round(1.58 * RNG(1).normal(0, 1, (18_000, 6)))
    moving = (np.arange(18_000) > 600) & (np.arange(18_000) < 17_400)
    values += np.where(moving, np.round(900 * np.sin(np.arange(18_000) / 20)), 0.0)[:, None]
    values[17_700:17_708, 5] = 0.0
    none = np.zeros(values.shape, bool)
    assert not find_stuck(values, moving, interval=0.01, clipped=none)
    values[17_700:17_730, 5] = 0.0
    assert find_stuck(values, moving, interval=0.01, clipped=none) == [(5, 17_700, 17_730)]


@pytest.mark.parametrize("length", [640, 641, 642, 700])
def test_a_channel_that_is_stuck_to_the_end_is_found(length: int) -> None:
    values = RNG(1).normal(0, 1, (length, 6))
    values[length // 2 :, 2] = 0.5
    moving = np.ones(length, bool)
    none = np.zeros(values.shape, bool)
    (found,) = find_stuck(values, moving, interval=0.01, clipped=none)
    assert found[0] == 2
    assert found[2] == length


def test_clipping_at_known_full_scale_and_by_its_plateaus() -> None:
    limit = 2.5
    cut = changed(4, slice(None), lambda v: np.clip(v, -limit, limit))
    expected = int((np.abs(bench().gyro[:, 1]) >= limit).sum())
    finding = the_finding(replace(cut, device=DeviceInfo()))
    assert (finding.kind, finding.channels) == ("clipping", ("gyro.y",))
    assert finding.count == expected
    whole = replace(bench(), gyro=np.clip(bench().gyro, -limit, limit))
    found = audit(replace(whole, device=DeviceInfo(gyro_full_scale=limit))).findings
    counts = {f.channels: f.count for f in found if f.kind == "clipping"}
    per_axis = (np.abs(bench().gyro) >= limit).sum(axis=0)
    assert counts == {(f"gyro.{a}",): n for a, n in zip("xyz", per_axis, strict=True)}
    counts = np.array([0.0, 5, 32766, 32767, 12, -32768])
    at = find_clipping(counts * 1e-3, full_scale=32.768, lsb=1e-3, noise=0.01)
    assert at.tolist() == [3, 5]


def test_the_top_of_a_brisk_turn_is_no_clipping() -> None:
    """Noise makes three samples of a smooth peak equal in one of some tens of recordings."""
    found, clipped = 0, 0
    time = np.arange(-30.0, 30.0)
    for seed in range(400):
        noise = RNG(seed).normal(size=(20, len(time)))
        peak = 500.0 - 0.5 * RNG(seed).uniform(1.0, 6.0) * np.square(time)
        size = RNG(seed).uniform(0.3, 0.9, 20) * (-1.0) ** np.arange(20)
        size[10] = 1.0
        turns = np.round(size[:, None] * np.maximum(peak, 0.0) + noise).ravel()
        found += bool(find_clipping(turns, full_scale=None, lsb=1.0, noise=1.0).size)
        cut = np.minimum(turns, 470.0)
        clipped += bool(find_clipping(cut, full_scale=None, lsb=1.0, noise=1.0).size)
    assert found <= 1
    assert clipped > 310


def test_peaks_that_a_median_filter_levels_are_no_clipping() -> None:
    time = np.arange(-30.0, 30.0)
    clipped = 0
    for seed in range(50):
        noise = RNG(seed).normal(size=(20, len(time)))
        size = RNG(seed).uniform(0.3, 1.0, 20) * (-1.0) ** np.arange(20)
        turns = (size[:, None] * 500.0 * np.exp(-np.square(time / 8.0)) + noise).ravel()
        level = median_filter(turns, 5)
        assert not find_clipping(level, full_scale=None, lsb=0.0, noise=1.0).size
        cut = np.clip(turns, -350.0, 350.0)
        clipped += bool(find_clipping(cut, full_scale=None, lsb=0.0, noise=1.0).size)
    assert clipped == 50


@pytest.mark.parametrize("noise", [0.0, 0.3, 1.0, 2.0])
@pytest.mark.parametrize("shift", [0.0, 0.5, 0.2])
def test_the_tops_of_a_machines_turns_are_no_clipping(noise: float, shift: float) -> None:
    """A table turns by the same peak time and again, at the same samples."""
    time = np.arange(-30.0, 30.0) + shift
    for seed in range(20):
        peak = 500.0 - 0.5 * RNG(seed).uniform(3.0, 40.0) * np.square(time)
        turns = np.tile(np.maximum(peak, 0.0), 30)
        turns = np.round(turns + noise * RNG(seed).normal(size=turns.shape))
        assert not find_clipping(turns, full_scale=None, lsb=1.0, noise=noise).size
        cut = np.minimum(turns, 400.0)
        assert find_clipping(cut, full_scale=None, lsb=1.0, noise=noise).size


def test_a_rate_that_another_axis_goes_beyond_is_no_limit() -> None:
    """A machine that turns about one axis by 66 degrees a second, and by 219 about another."""
    time = np.arange(2000) * 0.02
    level = np.round(np.clip(540.0 * np.sin(7.0 * time), -500.0, 500.0))
    faster = np.round(1700.0 * np.sin(0.7 * time))
    noise = np.ones(3)
    alone = np.stack((level, 0.1 * faster, 0.1 * level), axis=1)
    both = np.stack((level, faster, 0.1 * level), axis=1)
    found = find_limits(alone, full_scale=None, lsb=1.0, noise=noise)
    assert [bool(at.size) for at in found] == [True, False, False]
    assert not any(at.size for at in find_limits(both, full_scale=None, lsb=1.0, noise=noise))
    known = find_limits(both, full_scale=1700.0, lsb=1.0, noise=noise)
    assert known[1].size


def test_a_dead_and_a_stuck_channel() -> None:
    finding = the_finding(changed(2, slice(None), lambda v: v * 0))
    assert (finding.kind, finding.channels) == ("stuck", ("accel.z",))
    finding = the_finding(changed(3, slice(3000, 3400), lambda v: v[0]))
    assert (finding.kind, finding.channels) == ("stuck", ("gyro.x",))
    assert finding.times == (pytest.approx(30.0, abs=0.02),)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_register_that_is_read_twice(sign: float) -> None:
    values = values_of(bench())
    assert not find_copies(values)
    values = values.copy()
    values[:, 2] = sign * values[:, 1]
    ((c, d, where),) = find_copies(values)
    assert (c, d) == (1, 2)
    assert where.all()
    finding, *_ = audit(replace(bench(), accel=values[:, :3])).findings
    assert (finding.kind, finding.channels) == ("copied", ("accel.y", "accel.z"))


@pytest.mark.parametrize("counts", [0.3, 1.0, 4.0])
def test_axes_that_turn_alike_are_no_copies(counts: float) -> None:
    """A table about the diagonal of two axes, counted as finely as the noise, or not."""
    time = np.arange(60_000) / 100.0
    values = RNG(5).normal(0.0, counts, (len(time), 6))
    values[:, 3:5] += 3000.0 * np.sin(time / 7.0)[:, None]
    assert not find_copies(np.round(values))
    assert find_copies(np.round(values[:, [0, 1, 2, 3, 3, 5]]))
    # Without noise nobody can tell.
    still = np.maximum(np.sin(time / 7.0), 0.0)[:, None]
    assert not find_copies(np.round(3000.0 * np.repeat(still, 6, axis=1)))


@pytest.mark.parametrize("size", [0.02, -0.02, 0.3])
def test_spikes_are_named_and_a_knock_is_none(size: float) -> None:
    at = np.array([300, 1000, 5000])
    assert audit(bench()).static > 0.5
    found = find_spikes(
        values_of(changed(5, at, lambda v: v + size)), lsb=np.array([1e-3] * 3 + [2e-4] * 3)
    )
    assert set(found) <= {(k, k + 1, 5) for k in at.tolist()}
    assert (300, 301, 5) in found
    knock = changed(5, at, lambda v: v + size)
    knock = replace(knock, accel=knock.accel + 3 * (np.isin(np.arange(9786), at)[:, None]))
    assert audit(knock).findings == ()


@pytest.mark.parametrize("rate", [12.5, 20.0, 25.0])
def test_brisk_turns_of_few_samples_have_no_spikes(rate: float) -> None:
    for seed in range(12):
        rng = np.random.default_rng(seed)
        motion = bench_protocol(
            rng, poses=30, pose_duration=(1.5, 3.0), turn_duration=(0.5, 1.0), tremor=2.0
        )
        values = values_of(simulate(motion, SensorModel(), CONSUMER, rng=rng, rate=rate))
        assert find_spikes(values, lsb=resolution(values)) == [], seed
        # What is off by itself is one there, too.
        values[100:102, 4] += 3.0
        assert find_spikes(values, lsb=resolution(values)) == [(100, 102, 4)], seed


@pytest.mark.parametrize("seed", range(3))
def test_tails_of_noise_are_no_spikes_and_spikes_are(seed: int) -> None:
    """Student's t with six degrees of freedom, as much noise of cheap parts is."""
    rng = np.random.default_rng(seed)
    values = rng.standard_t(6.0, (200_000, 6)) * [0.03, 0.03, 0.03, 0.002, 0.002, 0.002]
    assert find_spikes(values, lsb=np.zeros(6)) == []
    values[[1000, 70_000, 70_001], [2, 4, 4]] = [2.0, 0.4, 0.4]
    found = find_spikes(values, lsb=np.zeros(6))
    assert found == [(1000, 1001, 2), (70_000, 70_002, 4)]


def test_spikes_of_all_sizes_are_no_tail_of_noise() -> None:
    """Small ones look like a tail, beyond which the large ones would be few."""
    rng = np.random.default_rng(0)
    values = rng.normal(size=(60_000, 6)) * 0.02
    at = np.arange(300, 59_000, 600)
    values[at, 1] += 0.02 * rng.normal(0, 12.0, len(at))
    found = find_spikes(values, lsb=np.zeros(6))
    assert {c for _, _, c in found} == {1}
    assert len(found) > 20
    assert {start for start, _, _ in found} <= set(at.tolist())


def test_spikes_are_said_with_what_becomes_of_them() -> None:
    finding = the_finding(changed(5, np.array([300, 1000, 5000]), lambda v: v + 0.3))
    assert finding.kind == "spikes"
    assert finding.channels == ("gyro.z",)
    assert finding.count == 3
    assert "calibrate, verify and diagnose bridge them" in finding.message


@pytest.mark.parametrize(
    ("triad", "factor", "unit"),
    [
        ("accel", 1 / 9.80665, "in g"),
        ("accel", 1000 / 9.80665, "in mg"),
        ("accel", 2.0, "full scale is half"),
        ("accel", 16384 / 9.80665, "counts of 16384 LSB/g"),
        ("gyro", 180 / np.pi, "in deg/s"),
        ("gyro", np.pi / 180, "converted from deg/s again"),
        ("gyro", 0.5, "full scale is twice"),
        ("gyro", 131 * 180 / np.pi, "counts of 131.0 LSB"),
    ],
)
def test_a_wrong_unit_is_refused_and_named(triad: str, factor: float, unit: str) -> None:
    wrong = replace(bench(), device=DeviceInfo(), **{triad: getattr(bench(), triad) * factor})
    with pytest.raises(UnitError, match=unit):
        check_units(wrong)
    finding = the_finding(wrong)
    assert (finding.kind, finding.channels) == ("unit", (triad,))


@given(
    st.lists(st.floats(-0.12, 0.12), min_size=6, max_size=6),
    st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3),
    st.lists(st.floats(-0.3, 0.3), min_size=3, max_size=3),
)
@settings(max_examples=15, deadline=None)
def test_no_error_of_a_real_sensor_passes_for_a_unit(
    scale: list[float], accel_bias: list[float], gyro_bias: list[float]
) -> None:
    model = SensorModel(
        Triad(np.array(accel_bias), np.array(scale[:3])),
        Triad(np.array(gyro_bias), np.array(scale[3:])),
    )
    signals = model.distort(State(bench().time, bench().accel, bench().gyro))
    check_units(replace(bench(), accel=signals.accel, gyro=signals.gyro))


def test_swapped_axes_are_no_unit_and_are_named() -> None:
    swapped = replace(bench(), gyro=bench().gyro[:, [1, 0, 2]] * [1, -1, 1])
    check_units(swapped)
    finding = the_finding(swapped)
    assert finding.kind == "axes"
    assert "x, y, z are its (-y, x, z)" in finding.message


def test_gravity_taken_out_is_said() -> None:
    b = bench()
    rest = RNG(3).normal(0, 0.02, (len(b), 3))
    with pytest.raises(UnitError, match="gravity was taken out"):
        check_units(replace(b, accel=rest))


def test_a_calibrated_log_says_so() -> None:
    import json

    truth = json.loads((ROOT / "fixtures" / "bench.truth.json").read_text("utf-8"))["parameters"]
    model = SensorModel(
        Triad().with_parameters({k: v for k, v in truth.items() if k.startswith("accel")}),
        Triad().with_parameters({k: v for k, v in truth.items() if k.startswith("gyro")}),
    )
    true = model.correct(State(bench().time, bench().accel, bench().gyro))
    done = replace(bench(), accel=true.accel, gyro=true.gyro, device=DeviceInfo())
    assert the_finding(done).kind == "calibrated"


def test_cut_and_invalid_clock() -> None:
    assert the_finding(replace(bench(), complete=False)).kind == "cut"
    assert the_finding(replace(bench(), clock="invalid")).kind == "clock"
    sweep = 20 + 40 * np.sin(2 * np.pi * bench().time / 8)
    assert "within a second" in the_finding(replace(bench(), temperature=sweep)).message


@pytest.mark.parametrize("n", [1, 2, 3, 10, 100])
def test_short_recordings_are_described(n: int) -> None:
    result = audit(bench().slice(0, n))
    assert result.samples == n
    assert result.findings == ()
