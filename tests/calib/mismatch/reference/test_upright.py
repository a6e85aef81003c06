"""Which way is up in a world that has other axes."""

import numpy as np
import pytest

from calib.mismatch.reference.upright import vertical
from calib.rotation import integrate_rate, mat_from_quat

GRAVITY = 9.80665


def shaken(size: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return orientations in a world with y up, rates, and what a body feels that is shaken so."""
    time = np.arange(0.0, 60.0, 0.01)
    rng = np.random.default_rng(4)
    waves = np.sin(np.multiply.outer(time, rng.uniform(2, 7, 9)) + rng.uniform(0, 6, 9))
    rate = 1.5 * waves @ rng.normal(size=(9, 3)) / 3.0
    mat = mat_from_quat(integrate_rate(time, rate))
    total = size * waves @ rng.normal(size=(9, 3)) / 3.0 + [0.0, GRAVITY, 0.0]
    return mat, rate, np.einsum("nij,ni->nj", mat, total)


@pytest.mark.parametrize("size", [0.0, 4.0, 9.0])
def test_what_a_body_is_shaken_by_comes_back_and_gravity_stays(size: float) -> None:
    mat, rate, felt = shaken(size)
    assert vertical(mat, rate, rate, felt) == pytest.approx([0.0, 1.0, 0.0])


def test_rates_about_other_axes_have_no_direction_that_is_up() -> None:
    mat, rate, felt = shaken(0.0)
    wrong = np.swapaxes(mat, 1, 2)
    assert vertical(wrong, rate, rate, felt) is None
