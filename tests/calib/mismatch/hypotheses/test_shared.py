"""One disturbance that three axes share, against the same columns mixed one by one."""

import numpy as np
import pytest
from scipy.special import logsumexp

from calib.mismatch.hypotheses.factors import log_bayes_factor, log_bayes_factors
from calib.mismatch.hypotheses.shared import (
    DIRECTIONS,
    factors_of_shares,
    likely_course,
    likely_share,
    with_shared,
)

COURSES = 5


@pytest.fixture
def columns() -> np.ndarray:
    """Return (hypotheses, rows, columns): five courses on each of three axes."""
    rng = np.random.default_rng(1)
    return rng.normal(size=(20, 60, 3 * COURSES))


def products(columns: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return np.swapaxes(columns, 1, 2) @ columns, y @ columns


def course(columns: np.ndarray, share: np.ndarray) -> np.ndarray:
    return sum(s * columns[:, a * COURSES : (a + 1) * COURSES] for a, s in enumerate(share))


def test_directions_are_those_with_two_axes_or_three():
    np.testing.assert_allclose(np.linalg.norm(DIRECTIONS, axis=1), 1.0)
    assert ((DIRECTIONS != 0).sum(axis=1) >= 2).all()
    between = np.abs(DIRECTIONS @ DIRECTIONS.T) - np.eye(len(DIRECTIONS))
    assert between.max() < 0.9
    # Nothing that two axes or three share is far from all of them and from every axis.
    rng = np.random.default_rng(0)
    any_ = rng.normal(size=(1000, 3))
    any_ /= np.linalg.norm(any_, axis=1, keepdims=True)
    near = np.abs(any_ @ np.vstack((DIRECTIONS, np.eye(3))).T).max(axis=1)
    assert near.min() > 0.85


def test_factors_of_shares_are_those_of_mixed_columns(columns):
    y = 2.0 * np.random.default_rng(2).normal(size=columns.shape[1])
    found = factors_of_shares(*products(columns, y))
    expected = [[log_bayes_factor(course(own, d), y) for d in DIRECTIONS] for own in columns]
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)


def test_what_is_shared_counts_as_much_as_courses_apart(columns):
    y = 2.0 * np.random.default_rng(3).normal(size=columns.shape[1])
    gram, match = products(columns, y)
    apart = log_bayes_factors(gram, match, np.zeros(len(gram), bool))
    found = with_shared(apart, gram, match)
    shared = logsumexp(factors_of_shares(gram, match), axis=1) - np.log(len(DIRECTIONS))
    np.testing.assert_allclose(found, np.logaddexp(apart, shared) - np.log(2.0))


def test_noise_alone_does_not_exceed_one_on_average():
    """A Bayes factor is an e-value. Its mean is one, of which rare large ones hold a part."""
    rng = np.random.default_rng(4)
    own = np.repeat(0.02 * rng.normal(size=(1, 60, 3 * COURSES)), 20, axis=0)
    found = []
    for _ in range(200):
        noise = rng.normal(size=(20, 60))
        gram, match = np.swapaxes(own, 1, 2) @ own, np.einsum("nmk,nm->nk", own, noise)
        apart = log_bayes_factors(gram, match, np.zeros(20, bool))
        found.append(np.exp(with_shared(apart, gram, match)))
    values = np.concatenate(found)
    assert 0.8 < values.mean() < 1.0 + 4 * values.std() / np.sqrt(len(values))
    assert np.mean(values > 10.0) < 0.1


@pytest.mark.parametrize("share", [(1.0, 0.0, -0.7), (0.2, 0.9, 1.0), (1.0, -0.8, 0.7)])
def test_a_share_is_found_and_gains_by_the_courses_that_it_saves(columns, share):
    own, share = columns[0], np.array(share) / np.linalg.norm(share)
    rng = np.random.default_rng(5)
    gained, right = [], 0
    for _ in range(20):
        y = course(own, share) @ rng.normal(size=COURSES) + rng.normal(size=len(own))
        found = likely_share(own, y)
        right += found is not None and abs(found @ share) > 0.9
        gram, match = products(own[None], y)
        apart = log_bayes_factors(gram, match, np.zeros(1, bool))
        gained.append((with_shared(apart, gram, match) - apart)[0])
    assert right >= 18
    assert np.median(gained) > 3.0


def test_three_courses_apart_are_no_shared_one(columns):
    own = columns[0]
    rng = np.random.default_rng(6)
    y = own @ (3.0 * rng.normal(size=3 * COURSES)) + rng.normal(size=len(own))
    assert likely_share(own, y) is None
    assert likely_course(own, own, y) is own


def test_the_course_of_a_share_has_the_columns_of_one(columns):
    own, share = columns[0], DIRECTIONS[0]
    rng = np.random.default_rng(7)
    y = course(own, share) @ (3.0 * rng.normal(size=COURSES)) + rng.normal(size=len(own))
    np.testing.assert_allclose(likely_course(own, own, y), course(own, share))
