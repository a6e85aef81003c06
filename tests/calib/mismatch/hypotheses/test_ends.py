"""Where a disturbance begins and ends: overlap, on average over what is as probable."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.mismatch.hypotheses.candidates import Candidate
from calib.mismatch.hypotheses.ends import Told, expected_overlap, place_window, tune_wave
from calib.mismatch.hypotheses.windows import moved_window, segment_columns, window_columns
from calib.mismatch.noise.noise import (
    expected_levels,
    level_basis,
    level_likelihood,
    make_whitener,
)
from calib.mismatch.noise.usual import usual_levels
from calib.mismatch.search.accepted import fitted
from calib.mismatch.search.ranking import make_stack

from ..bench import problem


def overlap(one: tuple[float, float], other: tuple[float, float]) -> float:
    common = min(one[1], other[1]) - max(one[0], other[0])
    return max(common, 0.0) / (max(one[1], other[1]) - min(one[0], other[0]))


@pytest.mark.parametrize("name", ["bias in a window", "gain in a window", "wave in a window"])
def test_a_window_is_found_from_one_that_only_touches_it(name):
    _, made = problem()
    rows = made.rows()
    stack = make_stack(rows, skip=(), reference=False)
    start, stop = float(rows.interval[9, 0]), float(rows.interval[20, 1])
    whitener = make_whitener(rows, expected_levels(rows), rows.white_diagonal, fitted(rows, []))
    found = [c for c in stack if c.name == name and c.channels == ("accel.y",)]
    near = [c for c in found if c.interval is not None and overlap(c.interval, (start, stop)) > 0]
    candidate = min(near, key=lambda c: overlap(c.interval or (0, 0), (start, stop)))
    assert overlap(candidate.interval or (0.0, 0.0), (start, stop)) < 0.2
    true = window_columns(rows, replace(candidate, interval=(start, stop))).sum(axis=1)
    if name == "wave in a window":
        # A wave keeps its phase and period wherever its window ends.
        inside = slice(9, 21)
        true = segment_columns(rows, candidate)[:, inside].sum(axis=(1, 2))
    size = 15.0 / np.linalg.norm(whitener.project(true))
    overlaps = []
    for seed in range(5):
        noise = np.random.default_rng(seed).normal(size=len(true))
        y = whitener.project(size * true) + noise - whitener.basis @ (whitener.basis.T @ noise)
        placed = place_window(rows, candidate, Told(whitener, y))
        assert placed.interval is not None
        overlaps.append(overlap(placed.interval, (start, stop)))
    assert np.median(overlaps) > 0.6


def test_columns_of_a_window_are_sums_over_its_segments():
    _, made = problem()
    rows = made.rows()
    stack = make_stack(rows, skip=(), reference=False)
    a, b = 5, 14
    window = float(rows.interval[a, 0]), float(rows.interval[b - 1, 1])
    for name in ("bias in a window", "gain in a window"):
        for one in (1, 3):
            alike = [c for c in stack if c.name == name and len(c.channels) == one]
            if not alike:
                continue
            parts = segment_columns(rows, alike[0])
            whole = window_columns(rows, moved_window(alike[0], *window))
            np.testing.assert_allclose(parts[:, a:b].sum(axis=1), whole, atol=1e-12)


def test_what_jumps_about_is_placed_whole_though_it_was_found_as_the_bias_of_a_part():
    _, made = problem()
    rows = made.rows()
    stack = make_stack(rows, skip=(), reference=False)
    start, stop = float(rows.interval[8, 0]), float(rows.interval[20, 1])
    whitener = make_whitener(rows, expected_levels(rows), rows.white_diagonal, fitted(rows, []))
    found = [c for c in stack if c.name == "bias in a window"]
    part = next(c for c in found if c.channels == ("gyro.x",) and c.index.size >= 4)
    parts = segment_columns(rows, part)[:, 8:21, 0]
    overlaps, names = [], set()
    for seed in range(5):
        rng = np.random.default_rng(seed)
        true = whitener.project(parts @ rng.normal(size=parts.shape[1]))
        noise = rng.normal(size=len(true))
        noise -= whitener.basis @ (whitener.basis.T @ noise)
        placed = place_window(
            rows, part, Told(whitener, 15.0 * true / np.linalg.norm(true) + noise)
        )
        assert placed.interval is not None
        overlaps.append(overlap(placed.interval, (start, stop)))
        names.add(placed.name)
    assert np.median(overlaps) > 0.7
    assert "fluctuation in a window" in names
    assert "bias in a window" not in names


def test_what_raises_the_drift_is_placed_as_the_usual_drift_shows_it():
    # Jumps in a window of a gyroscope raise the drift that is found of it, which hides the weaker.
    _, made = problem()
    rows = made.rows()
    stack = make_stack(rows, skip=(), reference=False)
    mean = fitted(rows, [])
    expected = expected_levels(rows)
    true = float(rows.interval[8, 0]), float(rows.interval[20, 1])
    part = next(c for c in stack if c.name == "bias in a window" and c.channels == ("gyro.x",))
    parts = segment_columns(rows, part)[:, 8:21, 0]
    own = np.array([c.name.startswith("gyro.x") for c in rows.components])
    raised = np.where(own, 15.0 * expected, expected)
    alone, beside = [], []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        noise = make_whitener(rows, expected, rows.white_diagonal, mean)
        jumps = parts @ rng.normal(size=parts.shape[1])
        jumps *= 9.0 / np.linalg.norm(noise.project(jumps))
        drift = rows.arrow.factorise(expected).dense() @ rng.normal(size=rows.n_dense)
        rest = np.sqrt(rows.white_diagonal) * rng.normal(size=len(jumps) - rows.n_dense)
        disturbed = rows.with_residual(jumps + np.append(drift, rest))
        usual = usual_levels(disturbed, raised, part.channels)
        assert usual is not None
        basis = level_basis(disturbed, mean)
        told = []
        for levels in (raised, usual):
            whitener = make_whitener(disturbed, levels, rows.white_diagonal, mean)
            y = whitener.project(disturbed.residual)
            told.append(Told(whitener, y, level_likelihood(disturbed, basis, levels)))
        for some, out in ((told[:1], alone), (told, beside)):
            out.append(overlap(place_window(disturbed, part, *some).interval or (0, 0), true))
    assert np.mean(beside) > np.mean(alone) + 0.1
    assert np.mean(beside) > 0.6


class Pulses:
    """A bench recording of which some segments have pulses of random heights, or none."""

    def __init__(self):
        _, made = problem()
        self.rows = made.rows()
        fixed = fitted(self.rows, [])
        levels = expected_levels(self.rows)
        self.whitener = make_whitener(self.rows, levels, self.rows.white_diagonal, fixed)
        self.stack = list(make_stack(self.rows, skip=(), reference=False))
        self.window = float(self.rows.interval[8, 0]), float(self.rows.interval[20, 1])

    def parts(self, channels: tuple[str, ...]) -> np.ndarray:
        """Return what a bias in each segment of the window makes on each channel."""
        biases = (c for c in self.stack if c.name == "bias in a window")
        own = next(c for c in biases if c.channels == channels)
        return segment_columns(self.rows, own)[:, 8:21]

    def placed(
        self, found: Candidate, parts: np.ndarray, seed: int, *, on: float = 0.75
    ) -> tuple[Candidate, float]:
        """Return where they are placed, and how much of that is the true window."""
        rng = np.random.default_rng(seed)
        heights = rng.laplace(size=13) * (rng.random(13) < on)
        true = self.whitener.project(parts @ heights)
        noise = rng.normal(size=len(true))
        noise -= self.whitener.basis @ (self.whitener.basis.T @ noise)
        y = 12.0 * true / np.linalg.norm(true) + noise
        placed = place_window(self.rows, found, Told(self.whitener, y))
        assert placed.interval is not None
        return placed, overlap(placed.interval, self.window)


@pytest.fixture(scope="module")
def pulses() -> Pulses:
    return Pulses()


def test_pulses_are_placed_with_those_that_hardly_show(pulses):
    own = [c for c in pulses.stack if c.channels == ("gyro.x",)]
    found = next(c for c in own if c.name == "fluctuation in a window")
    parts = pulses.parts(found.channels)[:, :, 0]
    overlaps = [pulses.placed(found, parts, seed)[1] for seed in range(10)]
    # With full confidence in normal disturbances: 0.72, and 0.33 at worst.
    assert np.mean(overlaps) > 0.77
    assert min(overlaps) > 0.42


def test_pulses_in_every_other_segment_are_placed_whole(pulses):
    own = [c for c in pulses.stack if c.channels == ("gyro.x",)]
    found = next(c for c in own if c.name == "fluctuation in a window")
    parts = pulses.parts(found.channels)[:, :, 0]
    overlaps = [pulses.placed(found, parts, seed, on=0.5)[1] for seed in range(20)]
    # As if one segment in four had none it would be 17; with full confidence 15.
    assert sum(o >= 0.5 for o in overlaps) > 17


def test_the_largest_pulse_of_many_is_placed_with_the_others(pulses):
    """It was found as a bias of its own window, and is as large as all others together."""
    own = [c for c in pulses.stack if c.name == "bias in a window" and c.channels == ("gyro.x",)]
    parts = pulses.parts(("gyro.x",))[:, :, 0]
    rows, overlaps = replace(pulses.rows, is_rest=np.zeros(len(pulses.rows.interval), bool)), []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        heights = rng.exponential(size=13) * (rng.random(13) < 0.75)
        heights[(most := int(rng.integers(13)))] = 4.0
        start, stop = rows.interval[8 + most]
        found = max(own, key=lambda c: overlap(c.interval or (0.0, 0.0), (start, stop)))
        true = pulses.whitener.project(parts @ heights)
        noise = rng.normal(size=len(true))
        noise -= pulses.whitener.basis @ (pulses.whitener.basis.T @ noise)
        y = 10.0 * true / np.linalg.norm(true) + noise
        placed = place_window(rows, found, Told(pulses.whitener, y))
        assert placed.interval is not None
        overlaps.append(overlap(placed.interval, pulses.window))
    # Otherwise 6 of 12 are placed as a bias of their own segment.
    assert sum(o > 0.3 for o in overlaps) > 9
    assert np.mean(overlaps) > 0.55


def test_pulses_that_two_axes_share_are_one_disturbance(pulses):
    """They are placed with one course, of which each axis has its share."""
    own = [c for c in pulses.stack if c.may_be_shared and c.channels[0] == "gyro.x"]
    found = max(own, key=lambda c: overlap(c.interval or (0.0, 0.0), pulses.window))
    parts = pulses.parts(found.channels) @ np.array([1.0, 0.0, -0.6])
    overlaps, shares = [], []
    for seed in range(10):
        placed, common = pulses.placed(found, parts, seed)
        overlaps.append(common)
        shares.append([placed.shape.get(axis, 0.0) for axis in "xyz"])
        columns = window_columns(pulses.rows, placed)
        assert columns.shape[1] == placed.shape["order"] * (1 if "x" in placed.shape else 3)
    assert np.mean(overlaps) > 0.7
    right = np.abs(shares) @ np.array([1.0, 0.0, 1.0]) > 1.4
    assert np.mean(right) >= 0.7


def test_a_short_bias_keeps_its_window():
    _, made = problem()
    rows = made.rows()
    stack = make_stack(rows, skip=(), reference=False)
    start, stop = float(rows.interval[14, 0]), float(rows.interval[15, 1])
    whitener = make_whitener(rows, expected_levels(rows), rows.white_diagonal, fitted(rows, []))
    found = [c for c in stack if c.name == "bias in a window"]
    step = next(c for c in found if c.channels == ("gyro.y",))
    true = whitener.project(segment_columns(rows, step)[:, 14:16, 0].sum(axis=1))
    overlaps = []
    for seed in range(6):
        noise = np.random.default_rng(seed).normal(size=len(true))
        noise -= whitener.basis @ (whitener.basis.T @ noise)
        placed = place_window(rows, step, Told(whitener, 6.0 * true / np.linalg.norm(true) + noise))
        assert placed.interval is not None
        overlaps.append(overlap(placed.interval, (start, stop)))
    # If evidence between kinds counted for less as well, it would pass for a longer jumble: 0.52.
    assert np.mean(overlaps) > 0.8


@pytest.mark.parametrize("later", [False, True])
def test_a_gain_that_changed_for_good_is_placed_in_the_shorter_part(later):
    """Beside the scale factor another gain before is the same: the longer part is the rule."""
    _, made = problem()
    rows = made.rows()
    stack = make_stack(rows, skip=(), reference=False)
    number = len(rows.interval)
    whitener = make_whitener(rows, expected_levels(rows), rows.white_diagonal, fitted(rows, []))
    own = [c for c in stack if c.name == "gain in a window"]
    found = next(c for c in own if c.channels == ("accel.y",) and not c.shape)
    overlaps = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        first = int(rng.integers(number // 4, number // 2)) + later * (number // 4 + 1)
        true = whitener.project(segment_columns(rows, found)[:, first:, 0].sum(axis=1))
        noise = rng.normal(size=len(true))
        noise -= whitener.basis @ (whitener.basis.T @ noise)
        placed = place_window(
            rows, found, Told(whitener, 12.0 * true / np.linalg.norm(true) + noise)
        )
        assert placed.interval is not None
        begin, end = float(rows.interval[0, 0]), float(rows.interval[-1, 1])
        moment = float(rows.interval[first, 0])
        overlaps.append(overlap(placed.interval, (moment, end) if later else (begin, moment)))
    assert np.median(overlaps) > 0.8


def test_a_wave_throughout_gets_its_period_between_those_of_the_grid():
    _, made = problem()
    rows = made.rows()
    stack = make_stack(rows, skip=(), reference=False)
    whitener = make_whitener(rows, expected_levels(rows), rows.white_diagonal, fitted(rows, []))
    waves = [c for c in stack if c.group == "wave throughout accel.y"]
    periods = np.array([c.shape["period"] for c in waves])
    true = 0.5 * (periods[7] + periods[8])
    signal = np.sin(2 * np.pi * rows.state.time / true + 1.0)
    y = whitener.project(rows.column({"accel.y": signal}))
    found, columns = tune_wave(rows, waves[7], whitener, 30.0 * y / np.linalg.norm(y))
    assert found.shape["period"] == pytest.approx(true, rel=0.01)
    mimicked = whitener.project(columns)
    left = y - mimicked @ np.linalg.lstsq(mimicked, y, rcond=None)[0]
    assert np.linalg.norm(left) < 0.1 * np.linalg.norm(y)


def test_the_interval_that_overlaps_most_is_that_of_all_pairs():
    rng = np.random.default_rng(6)
    start = rng.uniform(0.0, 90.0, 700)
    stop = start + rng.uniform(1.0, 20.0, 700)
    weight = rng.uniform(0.5, 1.0, 700)
    common = np.minimum.outer(stop, stop) - np.maximum.outer(start, start)
    hull = np.maximum.outer(stop, stop) - np.minimum.outer(start, start)
    best = int(np.argmax(np.maximum(common, 0.0) / hull @ weight))
    assert expected_overlap(start, stop, weight) == (start[best], stop[best])
