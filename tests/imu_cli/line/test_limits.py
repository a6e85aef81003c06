"""Limits and the quantities that they are written in."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from imu_cli.line.limits import Limits, Measured
from imu_cli.line.quantity import parse_quantity


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("60 mg", "m/s²", 0.5883990),
        ("-3 %", "1", -0.03),
        ("0.5dps", "rad/s", math.radians(0.5)),
        ("1e2 ppm", "1", 1e-4),
        ("15 deg/h", "rad/s", 7.27220522e-5),  # Earth's rate, about
    ],
)
def test_quantities_become_si(text: str, unit: str, value: float) -> None:
    assert parse_quantity(text, unit=unit) == pytest.approx(value, rel=1e-6)


@pytest.mark.parametrize("text", ["", "mg", "1 mgg", "1 2 g", "3 %"])
def test_what_is_no_acceleration_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"quantity|unit"):
        parse_quantity(text, unit="m/s²")


@given(st.floats(-1e6, 1e6), st.sampled_from(["mg", "g", "m/s²", "mm/s^2"]))
def test_a_written_number_is_read_back(value: float, unit: str) -> None:
    one = parse_quantity(f"1 {unit}", unit="m/s²")
    assert parse_quantity(f"{value!r} {unit}", unit="m/s²") == pytest.approx(value * one)


def measured() -> list[Measured]:
    return [
        Measured("accel.bias.x", 0.2, 0.001, "m/s²"),
        Measured("accel.bias.y", -0.9, 0.001, "m/s²"),
        Measured("gyro.scale_factor_error.z", 0.01, None, "1"),
    ]


def test_a_group_covers_its_axes_and_only_those() -> None:
    limits = Limits.from_tables({"accel.bias": {"max_abs": "80 mg"}}, {})
    checks = limits.check(measured(), [])
    assert [(c.name, c.passed) for c in checks] == [
        ("accel.bias.x", True),
        ("accel.bias.y", False),
    ]
    assert checks[1].failed


def test_a_limit_that_covers_nothing_fails() -> None:
    checks = Limits.from_tables({"accel.bais": {"max": "1 g"}}, {}).check(measured(), [])
    assert [c.failed for c in checks] == [True]


def test_findings_follow_their_action_or_the_default() -> None:
    limits = Limits.from_tables({}, {"default": "warn", "gyro_misalignment": "allow"})
    checks = limits.check([], ["gyro_misalignment", "accel_settling"])
    assert [(c.passed, c.action) for c in checks] == [(True, "allow"), (False, "warn")]


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("unexplaned", "did you mean unexplained"),
        ("defualt", "did you mean default"),
        ("gyro_misalignments", "did you mean gyro_misalignment"),
        ("magic", "known: accel_bias_step, .*, default"),
    ],
)
def test_a_finding_that_there_is_not_is_refused(name: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Limits.from_tables({}, {name: "fail"})


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ({"maximum": "1 g"}, "unknown key"),
        ({}, "no bound"),
        ({"max": 3}, "with its unit"),
        ({"max": "3 g", "max_abs": "3 g"}, "stands alone"),
        ({"max": "3 g", "action": "stop"}, "action"),
    ],
)
def test_a_wrong_limit_is_refused(entry: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Limits.from_tables({"accel.bias": entry}, {})


def test_a_wrong_unit_is_refused_when_held_against_a_number() -> None:
    limits = Limits.from_tables({"accel.bias": {"max": "3 dps"}}, {})
    with pytest.raises(ValueError, match="not in units of m/s²"):
        limits.check(measured(), [])
