"""What to do about what has no name."""

import pytest

from calib.effects import effects
from calib.mismatch.hypotheses.rivals import _KINDS, _OF_TRIADS
from calib.mismatch.hypotheses.windows import SLIPPED
from calib.mismatch.samples.found import FROZEN, SPIKES, SWAPPED, WRAPPED
from calib.mismatch.samples.spectrum import LINE, LOUDER_THERE
from calib.mismatch.samples.within import JOLTED, OFF_COURSE, PULSES
from calib.mismatch.search.explain import OF_POSES
from imu_cli.report.advice import AGAIN, next_step

IN_SAMPLES = (FROZEN, SPIKES, SWAPPED, WRAPPED, f"{LINE}23.6 Hz", LOUDER_THERE, JOLTED)


@pytest.mark.parametrize(
    "follows", [*IN_SAMPLES, OFF_COURSE, PULSES, OF_POSES, SLIPPED, *_KINDS, *_OF_TRIADS]
)
def test_every_kind_has_a_next_step(follows: str) -> None:
    step = next_step({"follows": follows})
    assert step
    assert "\n" not in step
    assert len(step) < 90
    if follows != "time":
        assert step != AGAIN


def test_the_step_is_of_the_kind() -> None:
    assert "mains" in next_step({"follows": "a line at 50 Hz, a line at 100 Hz"})
    assert "mount" in next_step({"follows": f"{SLIPPED}, by 2.1°"})
    assert "loose" in next_step({"follows": "these 4 turns: they do not close, by up to 1°"})
    assert "spread over all directions" in next_step({"follows": "direction of gravity"})


@pytest.mark.parametrize("follows", [e.follows for e in effects().values()])
def test_physics_that_is_not_proven_is_recorded_once_more(follows: str) -> None:
    assert next_step({"follows": f"{follows}, but not on held-out data"})
