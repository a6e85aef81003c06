"""Units and axes that are not those that are given, and turns that none make agree."""

from dataclasses import replace

import numpy as np
import pytest

from calib.mismatch import diagnose_recording
from calib.mismatch.samples.found import COPIED, DISAGREES

from ..bench import GRAVITY
from ..bench import recording as simulated


@pytest.mark.parametrize("poses", [1, 30])
def test_channels_that_are_one_or_dead_are_no_wrong_unit(poses: int) -> None:
    recording = simulated() if poses == 30 else simulated(poses=1)
    accel = recording.accel.copy()
    accel[:, 2] = accel[:, 1]
    found = diagnose_recording(replace(recording, accel=accel), gravity=GRAVITY)
    assert (found.verdict, found.findings) == ("unexplained", ())
    assert [(u.channels, u.follows) for u in found.unexplained] == [
        (("accel.y", "accel.z"), COPIED)
    ]
    assert "a register may be read twice" in found.missing[-1]
    accel[:, 2] = 0.0
    found = diagnose_recording(replace(recording, accel=accel), gravity=GRAVITY)
    assert (found.verdict, found.findings) == ("unexplained", ())
    assert [u.channels for u in found.unexplained] == [("accel.z",)]


def test_one_channel_in_another_unit_is_named() -> None:
    recording = simulated()
    for triad, axis, factor in (("gyro", 1, 180 / np.pi), ("accel", 2, 1 / 9.80665)):
        values = getattr(recording, triad).copy()
        values[:, axis] *= factor
        wrong = replace(recording, **{triad: values})
        found = diagnose_recording(wrong, gravity=GRAVITY)
        (finding,) = found.findings
        assert finding.effect == "unit_error"
        assert finding.channels == (f"{triad}.{'xyz'[axis]}",)
        assert finding.parameters[triad].value == pytest.approx(factor - 1, rel=0.1)


@pytest.mark.parametrize(("factor", "what"), [(1e3, "ms"), (1e6, "µs"), (1e9, "ns"), (100.0, "")])
def test_time_in_another_unit_is_named(factor: float, what: str) -> None:
    recording = simulated()
    (finding,) = diagnose_recording(
        replace(recording, time=factor * recording.time), gravity=GRAVITY
    ).findings
    assert finding.effect == "unit_error"
    assert finding.parameters["gyro"].value == pytest.approx(factor, rel=0.1)
    assert f"in {what}" in finding.sentence or not what


def test_turns_that_nothing_makes_agree_are_said_and_nothing_else() -> None:
    recording = simulated()
    copied = recording.gyro.copy()
    copied[:, 1] = 1.01 * copied[:, 0]
    for gyro in (copied, recording.gyro[::-1]):
        found = diagnose_recording(replace(recording, gyro=gyro), gravity=GRAVITY)
        assert found.verdict == "unexplained"
        assert not found.findings
        assert [u.follows for u in found.unexplained] == [DISAGREES]


def test_a_bias_that_no_gyroscope_has_is_said() -> None:
    recording = simulated()
    found = diagnose_recording(
        replace(recording, gyro=recording.gyro + np.array([0.0, 1e6, 0.0])), gravity=GRAVITY
    )
    assert (found.verdict, found.findings) == ("unexplained", ())
    assert found.unexplained[0].channels == ("gyro.y",)


@pytest.mark.parametrize("triads", [("accel",), ("gyro",), ("accel", "gyro")])
def test_zeros_end_with_a_verdict(triads: tuple[str, ...]) -> None:
    recording = simulated()
    zeros = {name: np.zeros_like(recording.accel) for name in triads}
    found = diagnose_recording(replace(recording, **zeros), gravity=GRAVITY)
    assert found.verdict in {"explained", "unexplained"}
    assert {f.effect for f in found.findings} <= {"unit_error"}


def test_a_bias_in_counts_is_none_that_no_gyroscope_has() -> None:
    recording = simulated()
    counts = 131.0 * 180 / np.pi * (recording.gyro + 0.05)
    (finding,) = diagnose_recording(replace(recording, gyro=counts), gravity=GRAVITY).findings
    assert finding.effect == "unit_error"
    assert finding.parameters["gyro"].value == pytest.approx(131.0 * 180 / np.pi, rel=0.1)
