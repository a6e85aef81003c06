"""Axes that are sampled one after another, beside a delay between the triads."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.calibration import Quantity
from calib.effects.base import Term
from calib.mismatch import diagnose_recording
from calib.mismatch.search.accepted import accept, with_parameters
from calib.mismatch.search.late import DELAY, SKEW, firsts_late, with_delay

from ..bench import GRAVITY, recording


@pytest.mark.parametrize(
    ("names", "more"),
    [(("accel_y", "gyro_z"), 1), (("gyro_y", "gyro_z"), 0), (("accel_z",), 0)],
)
def test_the_delay_is_fitted_beside_a_skew_of_both_triads(stacked, names, more):
    rows, stack = stacked
    whole = max((c for c in stack.physics.values() if c.name == SKEW), key=lambda c: len(c.index))
    skew = accept(stack, with_parameters(whole, names), 1.0)
    beside = with_delay(rows, [skew])
    assert beside.nuisance.shape[1] == rows.nuisance.shape[1] + more
    assert len(beside.prior) == len(rows.prior) + more * bool(len(rows.prior))
    np.testing.assert_array_equal(beside.residual, rows.residual)


def test_what_is_a_finding_of_its_own_is_no_nuisance(stacked):
    rows, stack = stacked
    both = [
        accept(stack, max(own, key=lambda c: len(c.index)), 1.0)
        for name in (SKEW, DELAY)
        if (own := [c for c in stack.physics.values() if c.name == name])
    ]
    assert len(both) == 2
    assert with_delay(rows, both) is rows


@pytest.mark.long
@pytest.mark.parametrize("seed", [3, 4, 5])
def test_a_skew_has_its_own_numbers_where_a_triad_is_late_as_well(seed):
    skew = {"accel_y": 3e-4, "accel_z": 6e-4, "gyro_y": 3e-4, "gyro_z": 6e-4}
    terms = Term(SKEW, skew), Term(DELAY, {"gyro_delay": 8e-4})
    found = diagnose_recording(recording(*terms, seed=seed, poses=24), gravity=GRAVITY)
    named = {f.effect: f for f in found.findings}
    assert SKEW in named
    for name, q in named[SKEW].parameters.items():
        assert abs(q.value - skew[name]) < 3.5 * q.sigma


def test_where_y_and_z_are_early_by_the_same_it_may_be_x_that_is_late():
    known = {
        "accel_y": Quantity(1e-5, 2e-5, "s"),
        "accel_z": Quantity(-3e-5, 2e-5, "s"),
        "gyro_y": Quantity(-7e-5, 1e-5, "s"),
        "gyro_z": Quantity(-6e-5, 1e-5, "s"),
    }
    said = firsts_late(SKEW, known)
    assert set(said) == {"gyro.x"}
    assert "x alone that is late" in said["gyro.x"]
    assert not firsts_late(SKEW, {**known, "gyro_z": Quantity(-14e-5, 1e-5, "s")})
    assert not firsts_late(SKEW, {"gyro_y": known["gyro_y"]})
    assert not firsts_late(DELAY, known)


@pytest.mark.long
def test_a_filter_on_x_alone_is_on_the_channels_of_that_triad():
    real = recording(seed=5, poses=24, rate=100.0)
    time, x = real.time, real.gyro[:, 0]
    gyro = real.gyro.copy()
    gyro[:, 0] = np.interp(time - 4e-3, time, x)
    found = diagnose_recording(replace(real, gyro=gyro), gravity=GRAVITY)
    item = found.findings[0]
    assert item.effect == SKEW
    assert item.channels == ("gyro.x", "gyro.y", "gyro.z")
    assert "x alone that is late" in item.sentence
