"""What one recording cannot tell: said as a tie, or not named at all."""

from dataclasses import replace

import numpy as np
import pytest

from calib.effects.base import Term
from calib.mismatch import diagnose_recording

from ..bench import GRAVITY, recording


@pytest.mark.long
def test_nothing_senses_more_than_the_earth_turns():
    """A g-sensitivity that is alike on all axes looks like a rotation about the vertical."""
    alike = Term("gyro_g_sensitivity", dict.fromkeys(("gxx", "gyy", "gzz"), 1e-4))
    found = diagnose_recording(recording(alike), gravity=GRAVITY)
    assert [f.effect for f in found.findings] == ["gyro_g_sensitivity"]
    assert "earth_rate" not in {r.effect for r in found.findings[0].rivals}


@pytest.mark.parametrize("reading", [None, 31.0])
@pytest.mark.long
def test_without_a_thermometer_that_moves_a_warm_up_may_be_one_of_temperature(reading):
    term = Term("gyro_warm_up", {"kx": 0.01, "kz": -0.01, "tau": 20.0})
    real = recording(term)
    stuck = None if reading is None else np.full(len(real), reading)
    found = diagnose_recording(replace(real, temperature=stuck), gravity=GRAVITY)
    (item,) = found.findings
    assert item.effect == "gyro_warm_up"
    assert "gyro_bias_temperature" in {r.effect for r in item.rivals}
    assert "Cool the sensor" in item.to_separate
    assert any("temperature" in text for text in found.missing)
