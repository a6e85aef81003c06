"""Closing in on where a function is highest."""

import pytest

from calib.mismatch.hypotheses.peak import CLOSE, close_in


@pytest.mark.parametrize("top", [-3.0, 0.0, 0.013, 0.9, 7.0])
def test_it_ends_near_the_top(top: float) -> None:
    def gain(x: float) -> float:
        return 5.0 - (x - top) ** 2

    found = close_in(gain, 0.0, gain(0.0), 1.0)
    assert 5.0 - CLOSE**2 <= found <= 5.0


def test_what_leads_nowhere_is_what_it_was() -> None:
    assert close_in(lambda _: -float("inf"), 1.0, 2.0, 0.1) == 2.0
    assert close_in(lambda x: x, 1.0, 2.0, 0.0) == 2.0
