"""What a model's delays and filters did to turns is taken out of them, and nothing is put in."""

from dataclasses import replace

import numpy as np
import pytest

from calib.effects.base import Term
from calib.mismatch.noise.sensornoise import sample_noise
from calib.mismatch.rows.grid import Grid, make_grid
from calib.mismatch.twin.twin import true_state
from calib.mismatch.twin.undone import undone
from calib.recording import Recording
from calib.statics import find_poses

from ..bench import problem, recording

LATE = Term("time_offset", {"gyro_delay": 0.03})


def moved(real: Recording, delay: float) -> Recording:
    k = round(delay / real.interval)
    return replace(real.slice(k, len(real)), gyro=real.gyro[:-k])


def grids(rate: float) -> tuple[Grid, Grid]:
    """Return a grid of a gyroscope that is 0.03 s late, and one of what it had been in time."""
    real = recording(rate=rate)
    late = moved(real, 0.03)
    poses = find_poses(late)
    return make_grid(late, poses), make_grid(real.slice(len(real) - len(late), len(real)), poses)


@pytest.mark.parametrize("rate", [100.0, 200.0])
def test_a_delay_is_taken_out_of_turns_sample_by_sample(rate: float) -> None:
    late, prompt = grids(rate)
    turns = late.pose < 0
    found = undone(late, (LATE,))
    np.testing.assert_array_equal(found.accel, late.accel)
    np.testing.assert_array_equal(found.gyro[~turns], late.gyro[~turns])
    off = found.gyro[turns] - prompt.gyro[turns]
    before = late.gyro[turns] - prompt.gyro[turns]
    # Only at its ends a turn has what its rests are on average in the place of their noise.
    ends = np.concatenate([late.turns[1].start, late.turns[1].last])
    noise = float(np.sqrt(np.median(sample_noise(late)[:, 3][turns])))
    assert np.abs(off).max() < 8 * noise
    assert 8 * noise < 0.2 * np.abs(before).max()
    near = np.abs(np.arange(turns.sum())[:, None] - ends).min(axis=1) < round(0.06 * rate)
    assert np.abs(off[~near]).max() < 1e-2 * noise


def test_filters_of_a_model_are_taken_out_in_the_order_opposite_to_theirs() -> None:
    grid, _ = problem()
    low = Term("bandwidth", {"gyro": 1.0, "gyro_cutoff": 20.0, "order": 1.0})
    both, turns = undone(grid, (low, LATE)).gyro, grid.pose < 0
    first = replace(grid, gyro=undone(grid, (LATE,)).gyro)
    second = undone(first, (low,)).gyro
    size = np.abs(both - grid.gyro)[turns].max()
    inner = np.ones(len(grid.time), bool)
    points, spans = grid.turns
    inner[points[np.concatenate([spans.start, spans.last])]] = False
    assert np.abs(both - second)[turns & inner].max() < 0.05 * size


def test_a_model_without_them_leaves_all_as_it_is() -> None:
    grid, self_mode = problem()
    found = undone(grid, (Term("gyro_g_sensitivity", {"gxx": 1e-3}),))
    assert found.gyro is grid.gyro
    assert found.accel is grid.accel
    still = replace(self_mode.twin.model, terms=(LATE,))
    state = true_state(grid, replace(self_mode.twin, model=still))
    rest = grid.pose >= 0
    np.testing.assert_array_equal(state.rate[rest], 0.0)
