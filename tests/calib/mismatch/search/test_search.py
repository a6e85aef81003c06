"""The search: one finding for one cause, however often the evidence comes back to it."""

from dataclasses import replace

import numpy as np
import pytest

from calib.effects.base import Term
from calib.mismatch import diagnose_recording
from calib.mismatch.hypotheses.rivals import FROM_START
from calib.mismatch.noise.noise import (
    expected_levels,
)
from calib.mismatch.search.accepted import accept
from calib.mismatch.search.ranking import make_stack
from calib.mismatch.search.search import _posterior

from ..bench import GRAVITY, problem, recording
from .stacked import candidate


@pytest.mark.long
def test_what_an_exponential_leaves_is_not_named_after_it_again():
    real = recording(
        Term("gyro_warm_up", {"kx": 0.02, "ky": -0.02, "tau": 15.0}),
        Term("gyro_warm_up", {"kx": 0.04, "ky": 0.03, "tau": 150.0}),
        poses=18,
    )
    # Without a thermometer nothing but time is left to follow.
    found = diagnose_recording(replace(real, temperature=None), gravity=GRAVITY)
    assert [f.effect for f in found.findings].count("gyro_warm_up") == 1
    assert {u.follows for u in found.unexplained} & {"time", FROM_START}
    warm = next(f for f in found.findings if f.effect == "gyro_warm_up")
    assert "gyro_bias_temperature" in {r.effect for r in warm.rivals}
    assert "Cool the sensor" in warm.to_separate


@pytest.mark.long
def test_a_twin_of_a_strong_effect_is_a_rival_though_its_column_is_a_derivative(monkeypatch):
    # While the temperature goes as an exponential, it and its rate differ by a constant only.
    sizes = {"kx": 10.0, "ky": -10.0, "kz": 20.0}
    real = recording(Term("accel_temperature_rate", sizes), poses=24)
    # The rate is as well known as the thermometer's steps let it be.
    real = replace(real, temperature=0.25 * np.round(4.0 * real.temperature))

    def named():
        (found,) = diagnose_recording(real, gravity=GRAVITY).findings
        return {found.effect, *(r.effect for r in found.rivals)}

    assert "accel_temperature_rate" in named()
    monkeypatch.setattr("calib.mismatch.search.twins.BLURRED", 0.0)
    assert "accel_temperature_rate" not in named()


@pytest.mark.parametrize(("size", "rival"), [(5.0, True), (-5.0, False)])
def test_what_would_be_of_an_impossible_size_is_no_rival(size, rival):
    """It lies beside a finding, however much more it explains."""
    _, self_mode = problem()
    rows = self_mode.rows()
    stack = make_stack(rows, skip=(), reference=True)
    earth = candidate(stack, "earth_rate", ("east", "north", "up"))
    smoothing = candidate(stack, "reference_smoothing", ("position",))
    residual = rows.residual + stack.of(earth).sum(axis=1) + size * stack.of(smoothing)[:, 0]
    rows = replace(rows, residual=residual)
    found = accept(stack, earth, 100.0)
    odds = _posterior(rows, stack, [found], 0, expected_levels(rows), reference=True)
    assert (odds.get("reference_smoothing", 0.0) > 0.5) is rival
