"""``imu-cal diagnose --reference`` with a table's commanded profile, from file to finding."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

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
