"""Effects that leave no residual: what they would be, and whether they are likely."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.effects.base import Term
from calib.mismatch import diagnose_recording
from calib.mismatch.findings.aliases import Alias
from calib.model import SensorModel, Triad
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import CONSUMER

from ..bench import GRAVITY

PLAIN = SensorModel(reference_temperature=30.0)
SCALED = replace(PLAIN, accel=Triad(scale_factor_error=np.array([0.01, -0.004, 0.002])))


def aliases(
    sensor: SensorModel, *, known: SensorModel | None = None, gravity: float = GRAVITY
) -> dict[str, Alias]:
    rng = np.random.default_rng(11)
    motion = bench_protocol(rng, poses=16, first_pose=2.0, pose_duration=(3.0, 4.0))
    motion = replace(motion, gravity=gravity)
    made = simulate(motion, sensor, CONSUMER, rng=rng, rate=100.0)
    found = diagnose_recording(made, gravity=GRAVITY, model=known)
    assert found.verdict == "consistent"
    assert set(found.to_json()["cannot_show"]) >= {a.effect for a in found.aliases}
    return {a.effect: a for a in found.aliases}


def test_a_wrong_gravity_is_a_scale_factor_that_all_axes_have() -> None:
    found = aliases(PLAIN, gravity=9.75)["gravity_magnitude"]
    error = found.parameters["error"]
    assert found.alike
    assert found.alias_of == "accel.scale_factor_error"
    assert error.sigma is not None
    assert abs(error.value - (9.75 - GRAVITY)) < 3.5 * error.sigma
    assert error.unit == "m/s²"


def test_a_fast_clock_is_a_scale_factor_of_the_gyroscope() -> None:
    found = aliases(replace(PLAIN, terms=(Term("clock_scale", {"scale": 0.005}),)))["clock_scale"]
    scale = found.parameters["scale"]
    assert found.alike
    assert scale.sigma is not None
    assert abs(scale.value - 0.005) < 3.5 * scale.sigma


@pytest.mark.parametrize("sensor", [PLAIN, SCALED])
def test_axes_that_are_right_or_differ_are_their_own(sensor: SensorModel) -> None:
    assert not any(a.alike for a in aliases(sensor).values())


def test_a_calibration_is_where_scale_factors_are_counted_from() -> None:
    found = aliases(SCALED, known=SCALED, gravity=9.75)["gravity_magnitude"]
    error = found.parameters["error"]
    assert found.alike
    assert error.sigma is not None
    assert abs(error.value - (9.75 - GRAVITY)) < 3.5 * error.sigma


def test_what_no_part_is_off_by_is_in_common_though_axes_differ_as_those_of_parts_do() -> None:
    scale = np.array([-0.13, -0.14, -0.125])
    found = aliases(replace(PLAIN, accel=Triad(scale_factor_error=scale)))["gravity_magnitude"]
    assert found.alike
    few = 0.02 * scale / 0.13
    found = aliases(replace(PLAIN, accel=Triad(scale_factor_error=few)))["gravity_magnitude"]
    assert not found.alike
