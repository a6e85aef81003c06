"""A recording against its own digital twin."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from calib.effects.base import Term
from calib.errors import RecordingFormatError
from calib.mismatch import diagnose_against
from calib.mismatch.reference.twinned import NOTE, twin_sensor, with_sensor
from calib.model import SensorModel, Triad
from calib.recording import Recording
from calib.simulate import digital_twin, simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import CONSUMER
from calib.simulation.recorded import motion_of
from calib.statics import find_poses

GRAVITY = 9.80665
KNOWN = Term("gyro_g_sensitivity", {"gxx": 3e-3, "gyy": -2e-3, "gzx": 1e-3})
LEFT_OUT = Term("accel_quadratic", {"kx": 1e-3, "ky": -1e-3, "kz": 1e-3})
SENSOR = SensorModel(
    Triad(np.array([0.2, -0.1, 0.3]), np.array([0.01, -0.02, 0.005])),
    Triad(np.array([0.01, 0.02, -0.01]), np.array([0.01, -0.01, 0.02])),
    (KNOWN,),
    20.0,
)


@cache
def real() -> Recording:
    rng = np.random.default_rng(3)
    motion = bench_protocol(rng, poses=24, first_pose=1.0, pose_duration=(2.0, 3.0))
    model = replace(SENSOR, terms=(KNOWN, LEFT_OUT))
    return simulate(motion, model, CONSUMER, rng=rng, rate=50.0)


@cache
def twin() -> Recording:
    log = real()
    motion = motion_of(log, SENSOR, find_poses(log), gravity=GRAVITY)
    made = digital_twin(log, motion, SENSOR, CONSUMER, rng=np.random.default_rng(4))
    return with_sensor(made, SENSOR)


def test_a_twin_says_which_sensor_it_is_of():
    found = twin_sensor(real(), twin())
    for triad in ("accel", "gyro"):
        own, said = getattr(SENSOR, triad), getattr(found, triad)
        assert own.parameters(triad) == said.parameters(triad)
    assert found.terms == SENSOR.terms
    assert found.reference_temperature == SENSOR.reference_temperature


@pytest.mark.long
def test_what_is_left_out_is_what_the_sensor_of_the_twin_lacks():
    found = diagnose_against(real(), twin(), gravity=GRAVITY)
    assert found.names
    assert "accel_quadratic" in {
        name for f in found.findings for name in (f.effect, *(r.effect for r in f.rivals))
    }
    assert "gyro_g_sensitivity" not in {f.effect for f in found.findings}
    assert "--calibration" in found.missing[-1]


def test_a_simulation_at_other_times_is_no_twin():
    late = replace(twin(), time=twin().time + 60.0)
    assert twin_sensor(real(), late) is None
    assert twin_sensor(real(), twin().slice(0, 500)) is None


@pytest.mark.parametrize(
    "text", ["accel.bias.x=", "no_effect:kx=1.0", "accel.bias.q=1.0", "accel=1.0", "x"]
)
def test_a_damaged_note_is_refused(text):
    odd = replace(twin(), notes={NOTE: f"{text} reference_temperature=25.0"})
    with pytest.raises(RecordingFormatError, match="twin_sensor"):
        twin_sensor(real(), odd)
