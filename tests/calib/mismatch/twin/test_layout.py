"""Rows of a grid have one place each; weights over a rest are what their names say."""

import numpy as np

from calib.mismatch.rows.rows import Kind
from calib.mismatch.twin.layout import Layout

from ..bench import problem


def test_every_row_is_of_one_segment_and_kind() -> None:
    grid, _ = problem()
    layout = Layout.of(grid)
    every = np.concatenate((layout.rows.ravel(), layout.ends.ravel()))
    np.testing.assert_array_equal(np.sort(every), np.arange(layout.number))
    closes = np.isin(layout.kind, (Kind.ATTITUDE, Kind.VELOCITY))
    np.testing.assert_array_equal(grid.is_rest[layout.segment], ~closes)
    assert (layout.channel[closes] == -1).all()


def test_a_mean_and_two_contrasts_that_do_not_see_it() -> None:
    grid, _ = problem()
    layout = Layout.of(grid)
    sums = [np.bincount(layout.cell, w) for w in layout.weights]
    np.testing.assert_allclose(sums[0], 1.0)
    np.testing.assert_allclose(sums[1:], 0.0, atol=1e-12)
    # Of white noise all three have one variance, and know nothing of each other.
    count = grid.count[layout.still]
    for a in range(3):
        for b in range(3):
            shared = np.bincount(layout.cell, layout.weights[a] * layout.weights[b] / count)
            alone = np.bincount(layout.cell, np.square(layout.weights[0]) / count)
            np.testing.assert_allclose(shared / alone, float(a == b), atol=1e-9)


def test_an_attitude_knows_nothing_of_accelerometers() -> None:
    grid, _ = problem()
    layout = Layout.of(grid)
    turning = np.ones((5, len(grid.turns[0]), 3))
    for c in range(6):
        felt = np.diff(layout.functional(c, turning[:, :, 0], len(grid.time)).indptr)
        attitude = felt[layout.kind == Kind.ATTITUDE]
        assert (attitude > 0).all() if c > 2 else (attitude == 0).all()
