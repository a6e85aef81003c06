"""Spectra of the parts that both know, against scipy's of a whole that has no gap."""

import numpy as np
import pytest
from scipy.signal import coherence, csd, welch

from calib.mismatch.reference.spectra import spectra_of

RATE = 100.0


def two(n: int = 4000) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    common = np.cumsum(rng.normal(size=(n, 3)), axis=0)
    return common, common + rng.normal(size=(n, 3))


def test_without_a_gap_they_are_those_of_scipy() -> None:
    one, other = two()
    found = spectra_of(one, other, RATE, np.ones(len(one), bool), "hann")
    assert found is not None
    given = {"fs": RATE, "nperseg": 200, "axis": 0}
    np.testing.assert_allclose(found.one, welch(one, **given)[1])
    np.testing.assert_allclose(found.cross, csd(one, other, **given)[1])
    np.testing.assert_allclose(found.coherence(), coherence(one, other, **given)[1])
    assert found.number == pytest.approx(20.0)


@pytest.mark.parametrize("every", [3000, 400])
def test_what_one_does_not_know_has_no_part_in_them(every: int) -> None:
    one, other = two(12000)
    known = np.arange(len(one)) % every >= every // 4
    whole = spectra_of(one, other, RATE, known, "hann")
    spoilt = np.where(known[:, None], other, 0.0)
    found = spectra_of(one, spoilt, RATE, known, "hann")
    assert found is not None
    assert whole is not None
    np.testing.assert_allclose(found.other, whole.other)
    np.testing.assert_allclose(found.coherence(), whole.coherence())


def test_a_channel_that_stands_still_shares_nothing_and_what_is_short_tells_nothing() -> None:
    one, other = two()
    other[:, 1] = 0.0
    known = np.ones(len(one), bool)
    found = spectra_of(one, other, RATE, known, "hann")
    assert found is not None
    assert not found.coherence()[:, 1].any()
    assert spectra_of(one, other, RATE, np.arange(len(one)) % 10 > 0, "hann") is None
