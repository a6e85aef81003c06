"""``imu-cal diagnose --reference`` with a table's commanded profile, from file to finding."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from calib.rotation import quat_from_rotvec, quat_multiply
from calib.simulation.library import make_motion
from imu_cli.app import app

START = 100.0
"""What the table's clock shows when the recording begins, s."""


def motion_of(name: str, duration: float):
    return make_motion(name, rng=np.random.default_rng(0), duration=duration, gravity=9.80665)


def simulated(path: Path, motion: str, duration: str, *effects: str) -> Path:
    given = [word for effect in effects for word in ("--effect", effect)]
    command = ["simulate", "-o", str(path), "--motion", motion, "--duration", duration]
    result = CliRunner().invoke(app, [*command, "--rate", "50", "--seed", "3", *given])
    assert result.exit_code == 0, result.output
    return path


def diagnosed(log: Path, reference: Path) -> dict:
    result = CliRunner().invoke(
        app, ["diagnose", str(log), "--reference", str(reference), "--json"]
    )
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


@pytest.fixture(scope="module")
def commanded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write what a record player was told to do, at 20 Hz on a clock of its own."""
    time = np.arange(0.0, 60.0, 0.05)
    quat = motion_of("record-player", 60.0).kinematics(time)[0].quat
    angle = np.degrees(np.unwrap(2 * np.arctan2(quat[:, 3], quat[:, 0])))
    path = tmp_path_factory.mktemp("table") / "profile.csv"
    lines = [f"{t + START:.4f},{a:.9f}" for t, a in zip(time, angle, strict=True)]
    path.write_text("\n".join(["time,angle_deg", *lines]) + "\n")
    return path


def test_a_commanded_profile_gives_arm_tilt_and_time(commanded: Path, tmp_path: Path) -> None:
    log = simulated(
        tmp_path / "log.arrow", "record-player", "60s", "reference_tilt:east=0.01,north=-0.006"
    )
    document = diagnosed(log, commanded)
    found = {item["effect"]: item["parameters"] for item in document["findings"]}
    assert set(found) == {"time_offset", "reference_tilt", "accel_lever_arm"}
    assert not document["unexplained"]
    expected = {
        ("time_offset", "delay"): -START,
        ("reference_tilt", "east"): 0.01,
        ("reference_tilt", "north"): -0.006,
        ("accel_lever_arm", "rx"): 0.08,
    }
    for (effect, name), value in expected.items():
        q = found[effect][name]
        assert abs(q["value"] - value) < 3.5 * q["sigma"], (effect, name, q)
        assert q["sigma"] < (5e-3 if name == "rx" else 1e-3)
    # A scale factor error of what the arm alone makes felt is the same as a longer arm; one axis
    # also tells neither the heading of the sensor on it nor most of its scale factors.
    assert "accel.scale_factor_error.x" in document["missing"][0]


@pytest.mark.long
def test_a_table_whose_every_pose_is_known_is_consistent(tmp_path: Path) -> None:
    motion = motion_of("rate-table", 130.0)
    time = np.arange(0.0, 130.0, 1 / 80)
    turning, path = motion.kinematics(time)
    reference = tmp_path / "poses.csv"
    columns = np.column_stack((time - 7.0, turning.quat, path.position))
    np.savetxt(
        reference, columns, fmt="%.9f", delimiter=",", header="time,qw,qx,qy,qz,x,y,z", comments=""
    )
    log = simulated(tmp_path / "log.arrow", "rate-table", "130s")
    document = diagnosed(log, reference)
    assert [item["effect"] for item in document["findings"]] == ["time_offset"]
    delay = document["findings"][0]["parameters"]["delay"]
    assert abs(delay["value"] - 7.0) < 3.5 * delay["sigma"]
    assert not document["unexplained"]
    assert not document["missing"]


@pytest.mark.long
def test_orientations_alone_of_a_body_that_may_be_carried_about_say_what_they_lack(
    tmp_path: Path,
) -> None:
    """A table of several axes has to be said; swapped markers and silent channels are told."""
    time = np.arange(0.0, 70.0, 1 / 80)
    turning, path = motion_of("rate-table", 70.0).kinematics(time)
    swapped = turning.quat.copy()
    turn = quat_from_rotvec(np.tile([0.0, 0.3, 0.0], (30, 1)))
    swapped[2400:2430] = quat_multiply(swapped[2400:2430], turn)
    reference = tmp_path / "poses.csv"
    columns = np.column_stack((time, swapped))
    np.savetxt(
        reference, columns, fmt="%.9f", delimiter=",", header="time,qw,qx,qy,qz", comments=""
    )
    log = simulated(tmp_path / "log.arrow", "rate-table", "70s")
    command = ["diagnose", str(log), "--reference", str(reference)]
    result = CliRunner().invoke(app, command)
    assert result.exit_code == 0, result.output
    assert "judged only at rest" in result.stderr
    assert "--fixed-point" in result.stderr
    assert "samples of the reference were left out" in result.stdout
    said = CliRunner().invoke(app, [*command, "--fixed-point", "--json"])
    assert said.exit_code == 0, said.output
    document = json.loads(said.stdout)
    assert not any("positions" in text for text in document["missing"])
    left = document["recording"]["swapped_markers"]
    assert 30 <= left["samples"] <= 40
    ((first, last),) = left["intervals"]
    assert first < 2400 / 80 < 2429 / 80 < last
    with_positions = tmp_path / "more.csv"
    columns = np.column_stack((columns, path.position))
    np.savetxt(
        with_positions,
        columns,
        fmt="%.9f",
        delimiter=",",
        header="time,qw,qx,qy,qz,x,y,z",
        comments="",
    )
    refused = CliRunner().invoke(
        app, ["diagnose", str(log), "--reference", str(with_positions), "--fixed-point"]
    )
    assert refused.exit_code != 0
    assert "expected orientations alone" in refused.stderr
    assert CliRunner().invoke(app, ["diagnose", str(log), "--fixed-point"]).exit_code == 2


def test_channels_without_noise_are_told(commanded: Path, tmp_path: Path) -> None:
    log = tmp_path / "exact.arrow"
    command = ["simulate", "-o", str(log), "--motion", "record-player", "--duration", "60s"]
    made = CliRunner().invoke(app, [*command, "--rate", "50", "--noise", "0"])
    assert made.exit_code == 0, made.output
    result = CliRunner().invoke(app, ["diagnose", str(log)])
    assert result.exit_code == 0, result.output
    assert "Without noise: accel.x" in result.stdout
