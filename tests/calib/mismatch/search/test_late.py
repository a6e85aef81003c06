"""Axes that are sampled one after another, beside a delay between the triads."""

from __future__ import annotations

import numpy as np
import pytest

from calib.effects.base import Term
from calib.mismatch import diagnose_recording
from calib.mismatch.search.accepted import accept, with_parameters
from calib.mismatch.search.late import DELAY, SKEW, with_delay

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
