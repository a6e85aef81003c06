"""What acts in a part of a recording only is no term of the sensor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.effects.bandwidth import low_pass
from calib.effects.base import Term
from calib.mismatch import diagnose_recording
from calib.mismatch.noise.contrast import contrast_variance
from calib.mismatch.noise.noise import expected_levels, make_whitener
from calib.mismatch.search.accepted import accept, fitted
from calib.mismatch.search.partly import IN_A_PART, _few, _products, acting_part
from calib.mismatch.search.ranking import make_stack
from calib.statics import find_poses

from ..bench import GRAVITY, drawn, motion_of, problem, recording, with_added
from .stacked import candidate

TERMS = {
    "gyro_g_sensitivity": ("gxx", "gxy", "gxz", "gyx", "gyy", "gyz", "gzx", "gzy", "gzz"),
    "gyro_scale_quadratic": ("kx", "ky", "kz"),
    "accel_quadratic": ("kx", "ky", "kz"),
    "accel_settling": ("kx", "ky", "kz"),
    "time_offset": ("gyro_delay",),
}


@pytest.mark.parametrize(
    "slug", [s if s == "time_offset" else pytest.param(s, marks=pytest.mark.long) for s in TERMS]
)
@pytest.mark.parametrize("power", [60.0, 400.0])
def test_a_part_is_found_and_all_of_it_is_none(slug: str, power: float) -> None:
    rows = problem()[1].rows()
    stack = make_stack(rows, skip=(), reference=False)
    finding = accept(stack, candidate(stack, slug, TERMS[slug]), 100.0)
    levels, rng = expected_levels(rows), np.random.default_rng(4)
    whitener = make_whitener(rows, levels, contrast_variance(rows), fitted(rows, []))
    column = finding.columns @ rng.normal(size=finding.columns.shape[1])
    number = len(rows.interval)
    later = column * (rows.segment >= number // 2)

    def sized(what: np.ndarray) -> np.ndarray:
        return what * np.sqrt(power / np.square(whitener.project(what)).sum())

    parts = 0
    for _ in range(12):
        noise = drawn(rows, levels, rng)
        contrast = contrast_variance(noise)
        whole = noise.with_residual(noise.residual + sized(column))
        assert acting_part(whole, [finding], 0, levels, contrast) is None
        there = noise.with_residual(noise.residual + sized(later))
        found = acting_part(there, [finding], 0, levels, contrast)
        if found is None:
            continue
        parts += 1
        start, stop = found.interval
        middle, end = rows.interval[number // 2, 0], rows.interval[-1, 1]
        common = min(stop, end) - max(start, middle)
        assert common > 0.5 * (max(stop, end) - min(start, middle))
    assert parts >= (9 if power > 100.0 else 2)


@pytest.mark.long
def test_a_gyroscope_that_feels_gravity_for_a_while_has_no_such_term() -> None:
    real = recording(seed=8, poses=30)
    rests = find_poses(real).interval
    begins = float(rests[14, 1])
    felt = 6e-4 * motion_of(real).gravity_direction[:, 2] * (real.time > begins)
    found = diagnose_recording(with_added(real, {"gyro.x": 2.0 * felt}), gravity=GRAVITY)
    assert not found.findings
    (left,) = found.unexplained
    assert left.channels == ("gyro.x",)
    start, stop = left.intervals[0]
    end = float(real.time[-1])
    assert min(stop, end) - max(start, begins) > 0.5 * (max(stop, end) - min(start, begins))


@pytest.mark.long
def test_a_filter_that_is_set_half_way_is_no_bandwidth_of_the_sensor() -> None:
    real = recording(seed=8, poses=30, rate=100.0)
    begins = float(find_poses(real).interval[14, 1])
    late = (real.time > begins)[:, None]
    slow = low_pass(real.time, real.gyro, 12.0, order=1)
    found = diagnose_recording(replace(real, gyro=np.where(late, slow, real.gyro)), gravity=GRAVITY)
    assert "bandwidth" not in {f.effect for f in found.findings}
    (left,) = (u for u in found.unexplained if IN_A_PART in u.follows)
    assert set(left.channels) == {"gyro.x", "gyro.y", "gyro.z"}
    start, stop = left.intervals[0]
    end = float(real.time[-1])
    assert min(stop, end) - max(start, begins) > 0.5 * (max(stop, end) - min(start, begins))


@pytest.mark.parametrize(
    "slug", ["gyro_g_sensitivity", "gyro_misalignment", "bandwidth", "accel_settling"]
)
@pytest.mark.long
def test_a_term_of_the_sensor_acts_throughout_however_strong_it_is(slug: str) -> None:
    sizes = {
        "gyro_g_sensitivity": {"gxx": 4e-3, "gyz": -4e-3, "gzx": 2e-3},
        "gyro_misalignment": {"mxy": 0.02, "mxz": 0.03, "myz": -0.03, "mzx": 0.02},
        "accel_settling": {"kx": 0.04, "ky": -0.03, "kz": 0.05, "tau": 1.3},
        "bandwidth": {"gyro": 1.0, "gyro_cutoff": 8.0, "order": 1.0},
    }
    found = diagnose_recording(recording(Term(slug, sizes[slug]), poses=20), gravity=GRAVITY)
    assert [f.effect for f in found.findings] == [slug]
    assert not any(IN_A_PART in left.follows for left in found.unexplained)


def test_columns_in_each_segment_have_the_products_of_their_few_directions() -> None:
    rng = np.random.default_rng(7)
    segment = rng.permutation(np.repeat(np.arange(6), [3, 1, 4, 2, 5, 3]))
    columns, y = rng.normal(size=(len(segment), 8)), rng.normal(size=len(segment))
    columns[segment == 4] = rng.normal(size=(5, 1)) * rng.normal(size=8)
    columns[segment == 5] = 0.0
    square = rng.normal(size=(len(segment), len(segment)))
    directions, mixing = _few(columns, segment, 6)
    assert mixing.shape == (6, 4, 8)
    gram, match = _products(square @ directions, y, mixing)
    parts = columns[:, None] * (segment[:, None] == np.arange(6))[:, :, None]
    white = np.einsum("mn,nsk->msk", square, parts)
    np.testing.assert_allclose(gram, np.einsum("mik,mjl->ikjl", white, white), atol=1e-12)
    np.testing.assert_allclose(match, np.einsum("m,mik->ik", y, white), atol=1e-12)
