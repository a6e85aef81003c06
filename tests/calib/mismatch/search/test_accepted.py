"""What was accepted is one finding for one cause."""

import numpy as np

from calib.mismatch.search.accepted import accept, again, joined

from .stacked import candidate


def test_parameters_of_one_effect_are_one_finding(stacked):
    rows, stack = stacked
    first = accept(stack, candidate(stack, "gyro_warm_up", ("kz",)), 100.0)
    first.values[:] = 2e-3
    new = accept(stack, candidate(stack, "gyro_warm_up", ("kx",)), 50.0)
    (both,) = joined(rows, [first], new, reference=False)
    assert both.candidate.parameters == ("kx", "kz")
    assert both.candidate.channels == ("gyro.x", "gyro.z")
    assert both.candidate.shape == first.candidate.shape
    np.testing.assert_array_equal(both.values, [0.0, 2e-3])
    np.testing.assert_allclose(both.columns[:, 1:], first.columns)
    assert again(candidate(stack, "gyro_warm_up", ("kx",)), [both])
    assert not again(candidate(stack, "gyro_warm_up", ("ky",)), [both])


def test_events_of_one_kind_stay_apart(stacked):
    rows, stack = stacked
    steps = [c for c in stack if c.name == "gyro_bias_step" and len(c.index) == 1]
    first, new = (accept(stack, c, 100.0) for c in (steps[0], steps[9]))
    assert len(joined(rows, [first], new, reference=False)) == 2
    assert not again(steps[0], [first])


def test_low_passes_of_unlike_channels_stay_apart(stacked):
    rows, stack = stacked
    first = accept(stack, candidate(stack, "bandwidth", ("accel",)), 100.0)
    new = accept(stack, candidate(stack, "bandwidth", ("gyro",)), 50.0)
    apart = joined(rows, [first], new, reference=False)
    assert [a.candidate.parameters for a in apart] == [("accel",), ("gyro",)]
