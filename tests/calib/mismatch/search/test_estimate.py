"""Sizes and shapes come back with honest standard errors, however far the grid was off."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

import calib.mismatch.search.estimate as module
from calib.effects import get_effect
from calib.mismatch.hypotheses.candidates import Candidate
from calib.mismatch.hypotheses.families import effect_columns, shape_grid
from calib.mismatch.noise.noise import (
    covariance,
    expected_levels,
    find_levels,
    make_whitener,
)
from calib.mismatch.search.accepted import Accepted
from calib.mismatch.search.estimate import estimate, settle, wider
from calib.mismatch.search.refine import likelihood_gain

from ..bench import drawn, problem

NAMES = ("kx", "kz")


def named(rows, slug: str, names: tuple[str, ...], **shape: float) -> Accepted:
    effect = get_effect(slug)
    found = effect_columns(effect, rows, shape, reference=False)
    channels = tuple(f"gyro.{n[-1]}" for n in names)
    index = np.arange(len(names))
    candidate = Candidate(slug, index, 1.0, True, channels, parameters=names, shape=shape)
    columns = np.stack([found[n] for n in names], axis=1)
    typical = np.full(len(names), effect.parameters[0].typical)
    return Accepted(candidate, columns, typical, np.zeros(len(names)), False, 1.0)


def step(rows, moment: float) -> Accepted:
    return named(rows, "gyro_bias_step", ("bx",), moment=moment)


def warm_up(rows, tau: float) -> Accepted:
    return named(rows, "gyro_warm_up", NAMES, tau=tau)


def test_a_profile_with_two_tops_is_followed_over_both(monkeypatch):
    _, self_mode = problem()
    rows = self_mode.rows()
    own = warm_up(rows, 30.0)
    (item,) = get_effect("gyro_warm_up").shape
    tops = np.log(shape_grid(item, rows, module.POINTS)[[3, 20]])
    at = []
    moved = module._moved

    def record(rows, a, shape, *, reference):
        at.append(np.log(shape["tau"]))
        return moved(rows, a, shape, reference=reference)

    def gain(columns, y, *, present=False):
        return float(-0.5 * np.square((at[-1] - tops) / 0.02).min())

    monkeypatch.setattr(module, "_moved", record)
    monkeypatch.setattr(module, "likelihood_gain", gain)
    values, gains = module._profile(
        rows,
        [own],
        0,
        own.candidate.shape,
        item,
        expected_levels(rows),
        rows.white_diagonal,
        reference=False,
    )
    near = np.log(values[gains > gains.max() - module.REACH])
    for top in tops:
        assert np.abs(near - top).min() < 0.05
    assert len(near) >= module.FINE


@pytest.mark.parametrize(("tau", "start"), [(30.0, 60.0), (250.0, 90.0)])
@pytest.mark.long
def test_a_time_constant_is_settled_and_its_errors_are_honest(tau, start):
    _, self_mode = problem()
    rows = self_mode.rows()
    levels, contrast = expected_levels(rows), rows.white_diagonal
    dense = np.linalg.cholesky(covariance(rows, levels))
    truth = warm_up(rows, tau)
    sizes = np.array([4e-3, -2e-3])
    rng = np.random.default_rng(5)
    errors, squares = [], []
    for _ in range(20):
        noise = np.append(
            dense @ rng.normal(size=rows.n_dense),
            np.sqrt(contrast) * rng.normal(size=len(contrast)),
        )
        real = replace(rows, residual=noise + truth.columns @ (sizes / truth.typical))
        # What the model already holds is put back into the rows.
        first = replace(warm_up(rows, start), in_model=True, values=0.5 * sizes)
        real = replace(
            real, residual=real.residual - first.columns @ (first.values / first.typical)
        )
        real, found = settle(real, [first], levels, contrast, reference=False)
        fit = estimate(real, tuple(found), levels, contrast, reference=False)
        part = slice(fit.at[0], fit.at[1])
        values = fit.step[part] * truth.typical
        sigma = np.sqrt(np.diag(fit.covariance)[part]) * truth.typical
        here = found[0].candidate.shape["tau"]
        errors.append([*((values - sizes) / sigma), (here - tau) / fit.shapes[0, "tau"]])
        own = np.array([*range(*fit.at), len(fit.step)])
        both = fit.joint([(0, "tau")])[np.ix_(own, own)]
        error = np.append((values - sizes) / truth.typical, here - tau)
        squares.append(error @ np.linalg.solve(both, error))
        assert np.linalg.eigvalsh(both / np.sqrt(np.outer(np.diag(both), np.diag(both)))).min() > 0
    z = np.array(errors)
    assert np.abs(z).max() < 3.5
    # 20 draws: 0.16 is one standard deviation. A shape whose end is open has errors to spare.
    assert (np.sqrt(np.mean(z**2, axis=0)) < 1.5).all()
    assert (np.sqrt(np.mean(z**2, axis=0)) > 0.3).all()
    # Sizes and time constant err together: 3 on average, with a standard deviation of 0.55.
    assert 0.9 < np.mean(squares) < 5.0


def test_a_moment_is_as_uncertain_as_the_rests_and_turns_beside_it_allow():
    _, self_mode = problem()
    rows = self_mode.rows()
    levels, contrast = expected_levels(rows), rows.white_diagonal
    dense = np.linalg.cholesky(covariance(rows, levels))
    fit_all = np.hstack((rows.baseline, rows.nuisance))
    whitener = make_whitener(rows, levels, contrast, fit_all)
    segments = rows.interval[3:-3].mean(axis=1)
    steps = [step(rows, float(m)) for m in segments]
    shown = [whitener.project(s.columns) for s in steps]
    middle = len(segments) // 2
    true = steps[middle].columns * np.sqrt(40.0 / np.square(shown[middle]).sum())
    rng = np.random.default_rng(6)
    errors = []
    for _ in range(20):
        noise = np.append(
            dense @ rng.normal(size=rows.n_dense),
            np.sqrt(contrast) * rng.normal(size=len(contrast)),
        )
        real = replace(rows, residual=noise + true[:, 0])
        y = whitener.project(real.residual)
        likeliest = int(np.argmax([likelihood_gain(columns, y) for columns in shown]))
        fit = estimate(real, (steps[likeliest],), levels, contrast, reference=False)
        errors.append((segments[likeliest] - segments[middle]) / fit.shapes[0, "moment"])
    assert np.abs(errors).max() < 3.5
    # In some draws it is another rest or turn that fits best.
    assert 0.2 < np.sqrt(np.mean(np.square(errors))) < 1.5


@pytest.mark.parametrize("spread", [0.0, 0.3, 1.0])
def test_three_wider_errors_hold_as_much_as_three_of_known_noise(spread):
    factor = wider(np.array([spread]))[0]
    z = np.linspace(-9, 9, 4001)
    share = norm.pdf(z) / norm.pdf(z).sum()
    outside = 2 * share @ norm.sf(3 * factor * np.exp(-0.5 * spread * z))
    assert outside == pytest.approx(2 * norm.sf(3.0), rel=1e-3)
    assert factor == pytest.approx(1.0) if spread == 0 else factor > 1.0


@pytest.mark.long
def test_drift_of_unknown_size_is_in_the_errors_of_what_it_can_mimic():
    _, self_mode = problem()
    rows = self_mode.rows()
    mean, contrast = np.hstack((rows.baseline, rows.nuisance)), rows.white_diagonal
    slow = named(rows, "gyro_bias_temperature", NAMES)
    beside = np.hstack((mean, slow.columns))
    groups = [c.group for c in rows.components]
    rng = np.random.default_rng(8)
    z = []
    for _ in range(60):
        # Parts of one make differ in how much they drift, by a factor of 2.
        shared = {group: rng.normal(0, 1.4) if group else 0.0 for group in sorted(set(groups))}
        true = expected_levels(rows) * np.exp([shared[group] for group in groups])
        real = drawn(rows, true, rng)
        levels = find_levels(real, beside, expected_levels(rows)).values
        fit = estimate(real, (slow,), levels, contrast, reference=False)
        part = slice(fit.at[0], fit.at[1])
        z += (fit.step[part] / np.sqrt(np.diag(fit.covariance)[part])).tolist()
    # 120 draws: 0.065 is one standard deviation.
    assert 0.7 < np.sqrt(np.mean(np.square(z))) < 1.15
    assert np.abs(z).max() < 3.5


@pytest.fixture(scope="module")
def apart():
    """Rows of a bench protocol, a finding, and what makes residuals of whitened ones."""
    _, self_mode = problem()
    rows = self_mode.rows()
    whitener = make_whitener(
        rows, expected_levels(rows), rows.white_diagonal, np.zeros((len(rows.residual), 0))
    )
    found = named(rows, "gyro_bias_temperature", ("kx",))
    along = whitener.whiten(found.columns[:, 0])
    return rows, found, along, np.linalg.inv(whitener.whiten(np.eye(len(along))))


@pytest.mark.parametrize("together", [0.0, 2.0])
def test_what_errs_together_in_a_segment_is_in_the_errors(apart, together):
    rows, found, along, back = apart
    noise = expected_levels(rows), rows.white_diagonal
    segments = int(rows.segment.max()) + 1
    length = np.sqrt(np.bincount(rows.segment, along**2, segments))[rows.segment]
    along = np.divide(along, length, out=np.zeros_like(along), where=length > 0)
    rng = np.random.default_rng(3)
    squares, plain, robust = [], [], []
    for _ in range(60):
        common = together * rng.normal(size=segments)[rows.segment] * along
        drawn_rows = rows.with_residual(back @ (rng.normal(size=len(along)) + common))
        step, covariance, _ = module.solved(drawn_rows, (found,), *noise)
        windows = module._together(drawn_rows, (found,), *noise)
        wide, count = windows.wider, windows.count
        squares.append(step[-1] ** 2)
        plain.append(covariance[-1, -1])
        robust.append(covariance[-1, -1] * wide[-1] ** 2)
        assert wide.min() >= 1.0
        assert 1.0 <= count.min() <= count.max() <= segments
    # 60 squares tell their mean to a fifth; thirty segments a variance to a quarter.
    assert 0.5 < np.mean(squares) / np.mean(robust) < 1.6
    if together:
        assert np.mean(squares) > 3.0 * np.mean(plain)
    else:
        assert np.mean(robust) < 1.35 * np.mean(plain)


def test_only_rows_that_may_err_together_have_wider_errors(apart):
    rows, found, along, back = apart
    noise = expected_levels(rows), rows.white_diagonal
    rng = np.random.default_rng(3)
    common = rng.normal(size=int(rows.segment.max()) + 1)[rows.segment] * along
    rows = rows.with_residual(back @ (rng.normal(size=len(along)) + common))
    sizes = []
    for clustered in (False, True):
        there = replace(rows, clustered=clustered)
        fit = estimate(there, (found,), *noise, reference=False)
        sizes.append(np.sqrt(np.diag(fit.covariance)))
    wide = module._together(rows, (found,), *noise).wider
    assert wide.max() > 1.05
    np.testing.assert_allclose(sizes[1], sizes[0] * wide, rtol=1e-9)


def test_what_is_put_aside_is_no_noise_of_segments(apart):
    rows, found, along, back = apart
    start = rows.baseline.shape[1] + rows.nuisance.shape[1]
    loose = np.stack((np.zeros(start), np.full(start, 1e6)), axis=1)
    rows = replace(rows, aligned=("time_offset.delay",), prior=loose)
    rng = np.random.default_rng(4)
    # A smooth function that is half what is found, and a hundred times the noise.
    other = rng.normal(size=len(along))
    shape = along / np.linalg.norm(along) + other / np.linalg.norm(other)
    smooth = replace(
        found,
        candidate=Candidate("time", np.arange(1), 1.0, False, found.candidate.channels),
        columns=(back @ shape)[:, None],
        typical=np.ones(1),
        values=np.zeros(1),
    )
    real = rows.with_residual(back @ (rng.normal(size=len(along)) + 100.0 * shape))
    noise = expected_levels(rows), rows.white_diagonal
    _, covariance, _ = module.solved(real, (found, smooth), *noise)
    _, alone, _ = module.solved(real, (found,), *noise)
    assert covariance[start, start] > 100.0 * alone[start, start]
    assert module._together(real, (found, smooth), *noise).wider[start] < 1.5


def test_a_g_sensitivity_is_told_from_the_vertical_part_of_the_earth_rate():
    """They are the same but for their size, and the Earth turns at 7.3e-5 rad/s, whatever is up."""
    _, self_mode = problem()
    rows = self_mode.rows()
    axes = ("x", "y", "z")
    felt = named(rows, "gyro_g_sensitivity", tuple(f"g{a}{b}" for a in axes for b in axes))
    earth = named(rows, "earth_rate", ("east", "north", "up"))
    found = estimate(
        rows, (felt, earth), expected_levels(rows), rows.white_diagonal, reference=False
    )
    own = slice(found.at[1], found.at[2])
    sigma = np.sqrt(np.diag(found.covariance)[own]) * earth.typical
    assert (sigma < 1.3 * get_effect("earth_rate").parameters[0].most).all()
    own = slice(found.at[0], found.at[1])
    sigma = np.sqrt(np.diag(found.covariance)[own]) * felt.typical
    assert (sigma < 3e-5).all()
