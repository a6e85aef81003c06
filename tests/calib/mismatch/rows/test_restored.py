"""The column of a low-pass is what it did to the turns, however strong it is."""

import numpy as np
import pytest

from calib.effects import get_effect
from calib.effects.base import Term, TransformEffect
from calib.mismatch.hypotheses.families import effect_columns
from calib.mismatch.noise.sensornoise import sample_noise
from calib.mismatch.rows.grid import make_grid
from calib.mismatch.rows.restored import whole_change
from calib.mismatch.rows.rows import Kind
from calib.mismatch.twin.residuals import build_rows
from calib.mismatch.twin.selfmode import SelfProblem
from calib.statics import find_poses

from ..bench import GRAVITY, problem, recording


@pytest.mark.parametrize(
    ("shape", "share"),
    [
        ({"gyro_cutoff": 6.0, "order": 2.0}, 0.02),
        ({"accel_cutoff": 6.0, "order": 1.0}, 0.02),
        # Of what both share only amplitude is left, and the fastest of that is lost in the noise.
        ({"both_cutoff": 6.0, "order": 1.0}, 0.15),
    ],
)
def test_the_change_of_a_low_pass_is_the_difference_that_it_made(
    shape: dict[str, float], share: float
) -> None:
    clean = recording(poses=18)
    filtered = recording(Term("bandwidth", shape), poses=18)
    poses = find_poses(clean)
    _, self_mode = problem()
    rows, plain = (
        build_rows(make_grid(real, poses), self_mode.twin, self_mode.noise)
        for real in (filtered, clean)
    )
    (found,) = effect_columns(get_effect("bandwidth"), rows, shape, reference=False).values()
    made = rows.residual - plain.residual
    for kind in (Kind.ATTITUDE, Kind.VELOCITY):
        size = np.linalg.norm(made[rows.kind == kind])
        assert np.linalg.norm((found - made)[rows.kind == kind]) < share * size + 1e-3
    assert not found[rows.kind <= Kind.CONTRAST].any()


@pytest.mark.parametrize("delay", [0.004, -0.03, 0.1])
def test_the_change_of_a_delay_is_the_difference_that_it_made(delay: float) -> None:
    clean = recording(poses=18)
    late = recording(Term("time_offset", {"gyro_delay": delay}), poses=18)
    poses = find_poses(late)
    grids = [make_grid(real, poses) for real in (late, clean)]
    twin = SelfProblem(grids[1], None, gravity=GRAVITY, full_gyro=False).twin
    rows, plain = (build_rows(grid, twin, sample_noise(grid)) for grid in grids)
    effect = get_effect("time_offset")
    assert isinstance(effect, TransformEffect)
    found = whole_change(effect, rows, {"gyro_delay": delay})
    assert found is not None
    turns = rows.kind >= Kind.ATTITUDE
    made = (rows.residual - plain.residual)[turns]
    assert np.linalg.norm(found[turns] - made) < 0.02 * np.linalg.norm(made) + 1e-3
    assert not found[~turns].any()


def test_each_part_of_a_low_pass_has_its_own_column() -> None:
    rows = problem()[1].rows()
    effect = get_effect("bandwidth")
    shape = {"accel_cutoff": 20.0, "gyro_cutoff": 30.0, "order": 1.0}
    both = effect_columns(effect, rows, shape, reference=False)
    assert list(both) == ["accel", "gyro"]
    alone = {"gyro_cutoff": 30.0, "order": 1.0}
    np.testing.assert_array_equal(
        effect_columns(effect, rows, alone, reference=False)["gyro"], both["gyro"]
    )


def test_rows_without_turns_have_no_column_of_a_low_pass() -> None:
    rows = problem()[1].rows()
    rests = rows.without(rows.kind >= Kind.ATTITUDE)
    shape = {"gyro_cutoff": 30.0, "order": 1.0}
    assert not effect_columns(get_effect("bandwidth"), rests, shape, reference=False)


def test_left_out_turns_leave_the_others_alone() -> None:
    rows = problem()[1].rows()
    turns = np.unique(rows.segment[rows.kind >= Kind.ATTITUDE])
    drop = np.isin(rows.segment, turns[[0, 5, 6, len(turns) - 1]])
    shape = {"gyro_cutoff": 10.0, "order": 1.0}
    whole, part = (
        effect_columns(get_effect("bandwidth"), r, shape, reference=False)["gyro"]
        for r in (rows, rows.without(drop))
    )
    np.testing.assert_allclose(part, whole[~drop], atol=1e-4 * np.abs(whole).max())
