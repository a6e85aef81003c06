"""What begins at a moment has the columns that its signals have, at any moment."""

from dataclasses import replace

import numpy as np
import pytest

from calib.effects import effects
from calib.mismatch.rows.onset import Onset

from ..bench import problem


@pytest.mark.parametrize("slug", [k for k, e in effects().items() if e.from_moment])
def test_columns_from_a_moment_on_are_those_of_the_signals(slug: str) -> None:
    rows, effect = problem()[1].rows(), effects()[slug]
    assert rows.confined
    onset, time = Onset(effect, rows), rows.state.time
    moments = np.concatenate(
        (rows.interval[:6].mean(axis=1), time[::400], [time[0] - 1.0, time[-1] + 1.0])
    )
    for moment in moments.tolist():
        signals = effect.columns(rows.state, {"moment": moment})
        found = onset.columns(moment)
        assert list(found) == list(signals)
        for name, values in signals.items():
            expected = rows.column(values)
            atol = 1e-12 * max(np.abs(expected).max(), 1e-9)
            np.testing.assert_allclose(found[name], expected, rtol=1e-9, atol=atol)


def test_every_effect_of_a_moment_alone_says_so() -> None:
    for effect in effects().values():
        assert effect.from_moment == ([item.name for item in effect.shape] == ["moment"])


def test_rows_that_feel_another_segment_are_told() -> None:
    rows = problem()[1].rows()
    assert not replace(rows, segment=np.roll(rows.segment, 1)).confined


def test_a_mean_at_rest_has_the_part_of_a_step_that_came_within_it() -> None:
    grid, rows = problem()[0], problem()[1].rows()
    middle = int(np.flatnonzero(grid.count > 1)[40])
    inside = grid.time[middle] + grid.length[middle] * np.linspace(-0.5, 0.5, 5)
    shares = [rows.state.since(moment)[middle] for moment in inside]
    np.testing.assert_allclose(shares, [1.0, 0.75, 0.5, 0.25, 0.0], atol=1e-9)
    sample = int(np.flatnonzero(grid.count == 1)[40])
    before, at = rows.state.since(grid.time[sample] + 1e-6), rows.state.since(grid.time[sample])
    assert (before[sample], at[sample]) == (0.0, 1.0)
