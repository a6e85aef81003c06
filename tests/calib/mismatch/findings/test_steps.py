"""When a bias jumped: found once, to a part of a second, with the standard error that it has."""

import numpy as np
import pytest

from calib.effects.base import Term
from calib.mismatch import diagnose_recording
from calib.model import SensorModel
from calib.recording import Recording
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import CONSUMER

GRAVITY = 9.80665


def stepped(
    seed: int, *, which: int, share: float, rest: float, noise: float
) -> tuple[Recording, float]:
    """A recording with a step at a share of one of its rests, and when that was."""
    rng = np.random.default_rng(seed)
    motion = bench_protocol(rng, poses=21, first_pose=1.0, pose_duration=(rest, 1.2 * rest))
    begin, end = motion.statics[which]
    moment = float(begin + share * (end - begin))
    step = Term("accel_bias_step", {"bx": 0.02, "by": 0.02, "bz": 0.02, "moment": moment})
    sensor = SensorModel(terms=(step,))
    return simulate(motion, sensor, CONSUMER.scaled(noise), rng=rng, rate=60.0), moment


@pytest.mark.long
@pytest.mark.parametrize(
    ("seed", "which", "share", "rest", "noise"), [(2, 10, 0.4, 20.0, 0.3), (8, 5, 0.15, 8.0, 1.0)]
)
def test_a_step_within_a_rest_is_one_finding_at_its_moment(seed, which, share, rest, noise):
    real, moment = stepped(seed, which=which, share=share, rest=rest, noise=noise)
    found = diagnose_recording(real, gravity=GRAVITY)
    assert [f.effect for f in found.findings] == ["accel_bias_step"]
    assert not found.unexplained
    when = found.findings[0].parameters["moment"]
    assert when.sigma < 1.0
    assert abs(when.value - moment) < 3.0 * when.sigma


@pytest.mark.parametrize("share", [0.08, 0.15, 0.92])
def test_a_step_of_a_gyroscope_beside_the_first_or_last_rests_is_found(share: float) -> None:
    """Of more than a bias drifts: rests with a rate of their own were none, and it was lost."""
    rng = np.random.default_rng(1)
    motion = bench_protocol(rng, poses=12)
    moment = share * motion.duration
    size = dict(zip(("bx", "by", "bz"), np.radians([0.5, -0.3, 0.2]), strict=True))
    step = Term("gyro_bias_step", {"moment": moment, **size})
    real = simulate(motion, SensorModel(terms=(step,)), CONSUMER, rng=rng, rate=100.0)
    found = diagnose_recording(real, gravity=GRAVITY)
    (finding,) = found.findings
    assert finding.effect == "gyro_bias_step"
    assert abs(finding.parameters["moment"].value - moment) < 1.0
    for name, true in size.items():
        assert abs(finding.parameters[name].value - true) < 4.0 * finding.parameters[name].sigma
