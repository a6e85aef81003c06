"""Columns on the rows that they touch are those on all rows."""

import numpy as np
import pytest

from calib.mismatch.hypotheses.columns import Columns, Seen
from calib.mismatch.noise.contrast import contrast_variance
from calib.mismatch.noise.noise import expected_levels, make_whitener
from calib.mismatch.search.accepted import fitted

from ..bench import problem


def test_columns_on_few_rows_are_seen_as_those_on_all():
    rows = problem()[1].rows()
    whitener = make_whitener(rows, expected_levels(rows), contrast_variance(rows), fitted(rows, []))
    y = whitener.project(rows.residual)
    rng = np.random.default_rng(2)
    columns, every = Columns(len(y)), []
    for channels in ((0,), (4,), (0,), (1, 2), range(6), (4,)):
        touched = np.flatnonzero(np.isin(rows.channel, (-1, *channels)))
        part = np.zeros((len(y), 3))
        part[touched] = rng.normal(size=(len(touched), 3))
        index = columns.add(part, None if len(channels) == 6 else touched)
        assert index.tolist() == [len(columns) - 3, len(columns) - 2, len(columns) - 1]
        every.append(part)
    every.append(rows.baseline[:, :1])
    columns.add(rows.baseline[:, :1])
    whole = np.hstack(every)
    chosen = rng.permutation(len(columns))
    np.testing.assert_array_equal(columns.take(chosen), whole[:, chosen])
    seen = columns.project(whitener, y, chosen)
    plain = whitener.project(whole[:, chosen])
    # What is fitted already is nothing.
    plain[:, chosen == len(columns) - 1] = 0.0
    np.testing.assert_allclose(seen.match, plain.T @ y, rtol=1e-9, atol=1e-9)
    for own in (np.arange(len(chosen)), np.array([3]), np.array([5, 2, 2])):
        expected = plain[:, own].T @ plain[:, own]
        size = expected.diagonal().max()
        np.testing.assert_allclose(seen.gram(own), expected, rtol=1e-9, atol=1e-12 * size)
        np.testing.assert_allclose(seen.power[own], expected.diagonal(), atol=1e-12 * size)
    place = np.argsort(chosen)  # where each column is among those that were chosen
    for sets in (place[[[0, 1], [2, 8]]], place[[[3, 5], [9, 12]]]):  # alike, and not
        np.testing.assert_allclose(seen.grams(sets), [seen.gram(each) for each in sets], rtol=1e-9)
    np.testing.assert_allclose(
        seen.total, np.square(whitener.whiten(whole[:, chosen])).sum(axis=0), rtol=1e-9
    )


def test_a_part_of_a_channel_cannot_be_whitened_by_itself():
    rows = problem()[1].rows()
    factor = rows.arrow.factorise(expected_levels(rows))
    touched = np.flatnonzero(rows.channel[: rows.n_dense] <= 0)
    values = np.random.default_rng(3).normal(size=(len(touched), 2))
    whole = np.zeros((rows.n_dense, 2))
    whole[touched] = values
    np.testing.assert_allclose(
        factor.restricted(touched).solve(values), factor.solve(whole)[touched], atol=1e-9
    )
    for some in (touched[1:], touched[:-1]):
        with pytest.raises(ValueError, match="whole blocks"):
            factor.restricted(some)


@pytest.mark.parametrize("number", [1, 2, 9])
def test_products_of_columns_that_share_some_rows_or_none(number):
    rng = np.random.default_rng(4)
    supports = [np.arange(6), np.arange(6, 10), np.array([1, 3, 8])]
    width = [5, 4, 7]
    support = np.repeat([0, 1, 2], width)
    white = {k: rng.normal(size=(len(supports[k]), width[k])) for k in range(3)}
    slot = np.concatenate([np.arange(w) for w in width])
    inner = rng.normal(size=(2, len(support)))
    none = np.zeros(len(support))
    seen = Seen(supports, white, support, slot, inner, none, none, none)
    whole = np.zeros((10, len(support)))
    for i, (k, at) in enumerate(zip(support, slot, strict=True)):
        whole[supports[k], i] = white[k][:, at]
    every = whole.T @ whole - inner.T @ inner
    sets = rng.permuted(np.tile(np.arange(len(support)), (number, 1)), axis=1)[:, :3]
    alike = np.stack([rng.integers(0, 5, number), rng.integers(5, 9, number)], axis=1)
    for own in (sets, alike):
        expected = [every[np.ix_(each, each)] for each in own]
        np.testing.assert_allclose(seen.grams(own), expected, atol=1e-12)
        np.testing.assert_allclose([seen.gram(each) for each in own], expected, atol=1e-12)
