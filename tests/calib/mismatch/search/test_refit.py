"""The joint fit: what no physics explains does not move the model far."""

from dataclasses import replace

import numpy as np
import pytest

from calib.effects.base import Term
from calib.mismatch import diagnose_recording
from calib.mismatch.noise.noise import expected_levels
from calib.mismatch.rows.grid import make_grid
from calib.mismatch.samples.found import PUSHED
from calib.mismatch.search.accepted import accept
from calib.mismatch.search.joint import solve
from calib.mismatch.search.ranking import make_stack
from calib.mismatch.search.refit import refit
from calib.mismatch.twin.selfmode import SelfProblem
from calib.statics import find_poses

from ..bench import GRAVITY, problem, recording


def test_a_smooth_rival_does_not_take_the_place_of_the_bias():
    _, self_mode = problem()
    rows = self_mode.rows()
    stack = make_stack(rows, skip=(), reference=False)
    rival = max(
        (c for c in stack if c.group == "direction of gravity gyro.z"),
        key=lambda c: 0 if c.mixing is not None else len(c.index),
    )
    found = [accept(stack, rival, 100.0)]
    assert found[0].columns.shape[1] > 9
    step = solve(rows, found, expected_levels(rows), rows.white_diagonal)
    bias = rows.names.index("gyro.bias.z")
    # Harmonics of a unit vector hold a constant, which is a bias; the bias is known to 1e-4 rad/s.
    assert abs(step[bias]) < 2e-3
    assert np.abs(step[-found[0].columns.shape[1] :]).max() < 30.0


def refitted(size):
    """Fit a misalignment jointly, from rows that lack it."""
    real = recording(Term("gyro_misalignment", {"mxy": size, "mzx": -size}), rate=100.0)
    grid = make_grid(real, find_poses(real))
    self_mode = SelfProblem(grid, None, gravity=GRAVITY, full_gyro=False)
    rows = self_mode.rows()
    stack = make_stack(rows, skip=(), reference=False)
    own = next(c for c in stack if c.name == "gyro_misalignment" and len(c.parameters) == 6)
    before = stack.of(own)
    found = refit(self_mode, rows, [accept(stack, own, 100.0)], expected_levels(rows))
    return found, before


def test_columns_are_what_they_were_where_a_fit_went_straight():
    found, before = refitted(1e-3)
    assert found.straight
    after = found.accepted[0].columns
    small = np.abs(after - before).max() / np.abs(before).max()
    found, before = refitted(0.1)
    assert not found.straight
    after = found.accepted[0].columns
    large = np.abs(after - before).max() / np.abs(before).max()
    assert small < 0.01 < large


def test_in_which_time_it_settles_is_refined_though_the_model_has_a_warm_up() -> None:
    """As it was found on one axis, beside noise that held the others, it was left."""
    size = {"kx": -0.18, "ky": 0.33, "kz": 0.22, "tau": 51.5}
    real = recording(Term("accel_warm_up", size), rate=100.0)
    grid = make_grid(real, find_poses(real))
    self_mode = SelfProblem(grid, None, gravity=GRAVITY, full_gyro=False)
    rows = self_mode.rows()
    stack = make_stack(rows, skip=(), reference=False)
    every = [c for c in stack if c.name == "accel_warm_up" and len(c.parameters) == 3]
    own = min(every, key=lambda c: abs(np.log(c.shape["tau"] / 30.0)))
    levels = expected_levels(rows)
    first = refit(self_mode, rows, [accept(stack, own, 100.0)], levels, refine=False)
    assert first.accepted[0].in_model
    assert first.accepted[0].candidate.shape == own.shape
    (found,) = refit(self_mode, first.rows, first.accepted, first.levels).accepted
    assert found.candidate.shape["tau"] == pytest.approx(51.5, rel=0.1)


@pytest.mark.long
def test_what_turns_by_a_tenth_is_fitted_as_well_as_what_turns_by_a_thousandth():
    """One step of the linearised fit would leave fifty standard errors."""
    pairs = ("xy", "xz", "yx", "yz", "zx", "zy")
    size = {f"m{p}": s for p, s in zip(pairs, (0.08, -0.1, 0.1, -0.08, 0.12, -0.1), strict=True)}
    real = recording(Term("gyro_misalignment", size), rate=100.0)
    (finding,) = diagnose_recording(real, gravity=GRAVITY).findings
    assert finding.effect == "gyro_misalignment"
    for name, true in size.items():
        found = finding.parameters[name]
        assert abs(found.value - true) < 3.5 * found.sigma


@pytest.mark.parametrize(("size", "follows"), [(1000.0, PUSHED), (150.0, "velocity")])
@pytest.mark.long
def test_what_no_sensor_puts_out_has_a_diagnosis(size: float, follows: str) -> None:
    """A step that leads nowhere is not taken: the next ones would go on to numbers that overflow.

    It adds up to 500 g to an axis in every turn, or what a sensor might just read.
    """
    real = recording(seed=5)
    accel, speed = real.accel.copy(), np.linalg.norm(real.gyro, axis=1)
    accel[:, 0] += size * speed * (speed > 0.1)
    found = diagnose_recording(replace(real, accel=accel), gravity=GRAVITY)
    left = found.unexplained[-1]
    assert "accel.x" in left.channels
    assert follows in left.follows
    assert all(np.isfinite(q.value) for f in found.findings for q in f.parameters.values())
    if follows == PUSHED:
        assert found.verdict == "unexplained"
        assert left.channels == ("accel.x",)
        assert not found.findings
