"""A chamber log of one pose: temperature and its rate are named, with a clock or with none."""

import numpy as np
import pytest

from calib.calibration import Gravity
from calib.document import from_document, to_document
from calib.effects.base import Term
from calib.mismatch import Diagnosis, diagnose_recording
from calib.mismatch.hypotheses.families import PHYSICAL, tried_effects
from calib.mismatch.rows.grid import make_grid
from calib.mismatch.search.ranking import make_stack
from calib.mismatch.twin.selfmode import SelfProblem
from calib.model import SensorModel, Triad
from calib.recording import Recording
from calib.simulate import Sampling, simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.motions import thermal_soak
from calib.simulation.noise import CONSUMER
from calib.statics import find_poses

from .bench import GRAVITY

BIAS = Term("accel_bias_temperature", {"kx": 2e-3, "kz": -3e-3, "qz": 2e-4, "cz": -3e-6})
RATE = Term("accel_temperature_rate", {"ky": 1.0, "kz": 2.0})


def chamber(*terms: Term, clock: str, seed: int = 3) -> Recording:
    motion = thermal_soak(temperatures=(25.0, -15.0, 65.0, 30.0), dwell=60.0, ramp=900.0)
    model = SensorModel(Triad(bias=np.array([0.1, -0.2, 0.1])), Triad(), terms, 25.0)
    rng = np.random.default_rng(seed)
    real = simulate(motion, model, CONSUMER, rng=rng, rate=4.0, sampling=Sampling(clock=clock))
    if clock == "device":
        return real
    # Order is real, time is not.
    return Recording(
        real.time / 700.0, real.accel, real.gyro, "invalid", temperature=real.temperature
    )


def diagnose(*terms: Term, clock: str = "invalid", seed: int = 3) -> tuple[Recording, Diagnosis]:
    real = chamber(*terms, clock=clock, seed=seed)
    return real, diagnose_recording(real, gravity=GRAVITY)


@pytest.mark.parametrize("clock", ["invalid", "device"])
@pytest.mark.long
def test_powers_of_temperature_and_its_rate_are_told_apart(clock):
    real, found = diagnose(BIAS, RATE, clock=clock)
    by_name = {f.effect: f for f in found.findings}
    assert set(by_name) == {"accel_bias_temperature", "accel_temperature_rate"}
    rate = by_name["accel_temperature_rate"]
    interval = 1.0 if clock == "device" else 0.25
    for name in ("ky", "kz"):
        q = rate.parameters[name]
        assert q.unit == ("(m/s²)/(K/s)" if clock == "device" else "(m/s²)/(K/sample)")
        assert q.value * interval == pytest.approx(RATE.parameters[name], rel=0.1)
    for item in by_name.values():
        # In one pose nobody knows which parameter of the accelerometer had it.
        assert not [a for a in item.absorbed_by if a.parameter.startswith("accel.")]
        assert item.held_out is not None
        before, after = item.held_out.channels["accel.z"]
        assert after < 0.5 * before
    made = found.calibration(real, gravity=Gravity(GRAVITY, "given"))
    kept = {t.effect for t in from_document(to_document(made)).model.terms}
    if clock == "device":
        assert kept == set(by_name)
    else:
        # A size per sample of unknown length fits no other stream.
        assert kept == {"accel_bias_temperature"}
        assert not [n for n in found.names if n.startswith("accel_temperature_rate")]
        assert any("clock" in text for text in found.missing)
    assert any("look alike" in text for text in found.missing)


@pytest.mark.parametrize("seed", [5, 6])
@pytest.mark.long
def test_a_sensor_without_terms_gets_none(seed):
    for clock in ("invalid", "device"):
        _, found = diagnose(clock=clock, seed=seed)
        assert not found.findings


def test_a_stuck_thermometer_names_no_temperature():
    real = chamber(BIAS, clock="invalid")
    stuck = Recording(
        real.time, real.accel, real.gyro, "invalid", temperature=np.full(len(real), 25.0)
    )
    found = diagnose_recording(stuck, gravity=GRAVITY)
    assert not [f for f in found.findings if "temperature" in f.effect]
    assert any("stuck" in text for text in found.missing)


def test_a_cube_comes_only_with_all_lower_powers():
    problem = SelfProblem(
        make_grid(real := chamber(clock="device"), find_poses(real)),
        None,
        gravity=GRAVITY,
        full_gyro=False,
    )
    stack = make_stack(problem.rows(), skip=(), reference=False)
    own = [c for c in stack if c.name == "accel_bias_temperature"]
    cubes = [c for c in own if any(n.startswith("c") for n in c.parameters)]
    assert [len(c.parameters) for c in cubes] == [9]
    assert {len(c.parameters) for c in own} == {1, 3, 6, 9}
    assert sum(c.weight for c in own) == pytest.approx(PHYSICAL / len(tried_effects()))


@pytest.mark.long
def test_what_warms_up_and_its_rate_fade_alike_and_neither_is_preferred():
    """A rate that is late where it is fastest lost that by 1 in 40."""
    rng = np.random.default_rng(1)
    motion = bench_protocol(rng, poses=30, warm_up=25.0, warm_up_time=100.0, power_on=0.0)
    model = SensorModel(terms=(Term("gyro_temperature_rate", {"ky": -6e-3, "kz": -6e-3}),))
    real = simulate(motion, model, CONSUMER, rng=rng, rate=50.0)
    (finding,) = diagnose_recording(real, gravity=GRAVITY).findings
    odds = {finding.effect: 1.0} | {r.effect: r.odds for r in finding.rivals}
    assert 0.2 < odds["gyro_temperature_rate"] / odds["gyro_bias_temperature"] < 5.0
