"""The rate table's method: what its profile may be, and what is refused."""

import numpy as np
import pytest
from gyro_motion import GRAVITY, Motion, simulate

from calib.errors import InsufficientMotionError
from calib.fit import Fit
from calib.model import Triad
from calib.solvers import gyro_solvers
from calib.turns import find_turns

GYRO = Triad([0.03, -0.06, 0.03], [0.1, -0.05, 0.2])
SPINS = 6.0 * np.array(
    [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1], [0.6, 0.8, 0]]
)
TRUTH = simulate(Motion(SPINS, turn=4.0, rate=50.0, ramp=0.1), GYRO, rng=np.random.default_rng(0))
TURNS = find_turns(TRUTH.recording, TRUTH.poses)
RATE = 6.0 / 4.0 / 0.9
PROFILE = np.column_stack([TURNS.interval + np.array([0.6, -0.6]), np.full(len(TURNS), RATE)])


def solve(**options: object) -> Fit:
    return gyro_solvers()["rate_table"].solve(
        TRUTH.recording, TRUTH.poses, TURNS, Triad(), gravity=GRAVITY, options=options
    )


@pytest.mark.parametrize(
    "table",
    [
        RATE,
        -RATE,
        np.full(len(TURNS), RATE),
        PROFILE,
    ],
    ids=["one", "signed", "per turn", "profile"],
)
def test_every_form_of_the_rate_gives_the_calibration(table: object) -> None:
    fit = solve(table_rate=table)
    truth = np.array(list(GYRO.parameters("gyro").values()))[:6]
    assert not fit.undetermined
    assert (np.abs(fit.values - truth) < 4.5 * fit.standard_errors).all()


def test_an_axis_that_never_faced_the_table_is_named() -> None:
    rows = PROFILE[:4]
    fit = solve(table_rate=rows)
    assert fit.undetermined == ("gyro.scale_factor_error.z",)
    assert "about axis z" in fit.advice[0]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "`table_rate` is needed"),
        ({"table_rate": [1.0, 2.0]}, "one for each of the 7 turns"),
        ({"table_rate": float("nan")}, "must be finite"),
        ({"table_rate": [[500.0, 600.0, 1.0]]}, "row 0 covers fewer than two samples"),
    ],
)
def test_a_bad_rate_is_refused(options: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        solve(**options)


def test_a_table_that_stood_still_is_refused() -> None:
    with pytest.raises(InsufficientMotionError, match="no spin was found"):
        solve(table_rate=0.0)
