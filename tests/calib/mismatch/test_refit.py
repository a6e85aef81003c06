"""The joint fit: what no physics explains does not move the model far."""

import numpy as np

from calib.mismatch.noise import expected_levels
from calib.mismatch.ranking import make_stack
from calib.mismatch.refit import solve
from calib.mismatch.search import _accept

from .bench import problem


def test_a_smooth_rival_does_not_take_the_place_of_the_bias():
    _, self_mode = problem()
    rows = self_mode.rows()
    stack = make_stack(rows, skip=(), reference=False)
    rival = max(
        (c for c in stack.candidates if c.group == "direction of gravity gyro.z"),
        key=lambda c: 0 if c.mixing is not None else len(c.index),
    )
    found = [_accept(rows, stack, rival, 100.0)]
    assert found[0].columns.shape[1] > 9
    step = solve(rows, found, expected_levels(rows), rows.white_diagonal)
    bias = rows.names.index("gyro.bias.z")
    # Harmonics of a unit vector hold a constant, which is a bias; the bias is known to 1e-4 rad/s.
    assert abs(step[bias]) < 2e-3
    assert np.abs(step[-found[0].columns.shape[1] :]).max() < 30.0
