"""``imu-cal diagnose`` as a user meets it: JSON alone on stdout, a model, clear refusals."""

import json
import os
import re
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from calib.effects.base import Term
from calib.model import SensorModel, Triad
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import CONSUMER, NoiseModel
from drivers.calibration_file import load_calibration
from drivers.formats import read_recording, write_recording
from imu_cli.app import app


def recorded(path: Path, *terms: Term, seed: int = 5) -> Path:
    rng = np.random.default_rng(seed)
    motion = bench_protocol(rng, poses=12, first_pose=2.0, pose_duration=(3.0, 4.0))
    model = SensorModel(Triad(), Triad(), terms)
    write_recording(simulate(motion, model, CONSUMER, rng=rng, rate=50.0), path)
    return path


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("diagnose")
    return recorded(folder / "log.arrow", Term("gyro_misalignment", {"mxy": 0.03}))


@pytest.fixture(scope="module")
def diagnosed(log: Path) -> tuple[str, Path]:
    """Diagnose the log; return what is on standard output, and the model that is written."""
    model = log.with_name("model.json")
    result = CliRunner().invoke(app, ["diagnose", str(log), "--json", "-o", str(model)])
    assert result.exit_code == 0, result.stderr
    return result.stdout, model


def test_json_is_alone_on_stdout_and_the_model_is_written(
    diagnosed: tuple[str, Path],
) -> None:
    said, model = diagnosed
    document = json.loads(said)
    assert document["format"] == "imu-cal/diagnosis"
    assert document["files"] == {"recording": "log.arrow"}
    assert document["verdict"] == "explained"
    assert document["findings"][0]["effect"] == "gyro_misalignment"
    terms = load_calibration(model).model.terms
    assert abs(terms[0].parameters["mxy"] - 0.03) < 0.003


@pytest.mark.long
def test_what_has_moved_since_a_calibration_is_no_effect_and_is_said(
    log: Path, diagnosed: tuple[str, Path], tmp_path: Path
) -> None:
    (_, known), later = diagnosed, tmp_path / "later.arrow"
    then = read_recording(log)
    write_recording(replace(then, accel=then.accel + np.array([0.0, 0.05, 0.0])), later)
    found = CliRunner().invoke(app, ["diagnose", str(later), "--calibration", str(known), "--json"])
    document = json.loads(found.stdout)
    assert document["verdict"] == "consistent"
    (moved,) = document["moved"]
    assert moved["parameter"] == "accel.bias.y"
    assert moved["shift"] == pytest.approx(0.05, abs=3 * moved["sigma"])
    said = CliRunner().invoke(app, ["diagnose", str(later), "--calibration", str(known)]).stdout
    assert said.startswith("Consistent with a calibration brought up to date")
    assert "Moved since the calibration" in said
    assert "   accel.bias.y by 5." in said
    same = CliRunner().invoke(app, ["diagnose", str(log), "--calibration", str(known)]).stdout
    assert "Moved" not in same
    # So is a term of the sensor that is there no more.
    without = recorded(tmp_path / "without.arrow", seed=6)
    found = CliRunner().invoke(
        app, ["diagnose", str(without), "--calibration", str(known), "--json"]
    )
    document = json.loads(found.stdout)
    assert document["verdict"] == "consistent"
    moved = document["moved"][0]
    assert moved["parameter"] == "gyro.misalignment.xy"
    assert moved["shift"] == pytest.approx(-0.03, abs=4 * moved["sigma"])


@pytest.mark.long
def test_what_a_calibration_states_without_standard_errors_can_have_moved_too(
    log: Path, diagnosed: tuple[str, Path], tmp_path: Path
) -> None:
    _, known = diagnosed
    document = json.loads(known.read_text())
    document["covariance"] = {"names": [], "units": [], "values": []}
    for own in document["parameters"].values():
        own["sigma"] = None
    for term in document["terms"]:
        for own in term["parameters"].values():
            own["sigma"] = None
    stated = tmp_path / "stated.json"
    stated.write_text(json.dumps(document))
    same = CliRunner().invoke(app, ["diagnose", str(log), "--calibration", str(stated)])
    assert same.stdout.startswith("Consistent:")
    assert re.search(r"residual +left +noise floor", same.stdout)
    document["parameters"]["gyro.bias.x"]["value"] += 0.03
    stated.write_text(json.dumps(document))
    found = CliRunner().invoke(app, ["diagnose", str(log), "--calibration", str(stated), "--json"])
    (moved,) = json.loads(found.stdout)["moved"]
    assert moved["parameter"] == "gyro.bias.x"
    assert moved["shift"] == pytest.approx(-0.03, abs=5e-4)


@pytest.mark.long
def test_the_screen_says_what_where_and_how_sure(log: Path) -> None:
    result = CliRunner().invoke(app, ["diagnose", str(log)], env={"COLUMNS": "40"})
    assert result.exit_code == 0
    for words in ("Explained", "gyro misalignment", "Where:", "How sure:", "held-out"):
        assert words in result.stdout
    table = result.stdout.partition("residual ")[2]
    assert "floor" in table
    # A narrow window takes no digits away.
    assert "…" not in table


def test_without_a_rest_the_verdict_says_so_and_no_model_is_written(tmp_path: Path) -> None:
    log, out = tmp_path / "paper.csv", tmp_path / "model.json"
    made = ["simulate", "--motion", "paper", "--duration", "20s", "--seed", "3", "-o", str(log)]
    assert CliRunner().invoke(app, made).exit_code == 0
    result = CliRunner().invoke(app, ["diagnose", str(log), "--json"])
    assert result.exit_code == 0, result.stderr
    document = json.loads(result.stdout)
    assert document["verdict"] == "undetermined"
    assert document["findings"] == []
    assert "a moment of rest" in document["missing"][0]
    refused = CliRunner().invoke(app, ["diagnose", str(log), "-o", str(out)])
    assert "Undetermined" in refused.stdout
    assert refused.exit_code == 4
    assert "no model is written" in refused.stderr
    assert not out.exists()


def test_a_missing_file_and_a_wrong_gravity_are_refused(log: Path, tmp_path: Path) -> None:
    assert CliRunner().invoke(app, ["diagnose", str(tmp_path / "no.csv")]).exit_code == 3
    wrong = CliRunner().invoke(app, ["diagnose", str(log), "--gravity", "32.2"])
    assert wrong.exit_code == 2
    assert "m/s²" in wrong.output


@pytest.mark.long
def test_gravity_is_taken_from_the_latitude_or_from_the_calibration(
    log: Path, tmp_path: Path
) -> None:
    out = tmp_path / "model.json"
    place = ["--latitude", "60", "--height", "100"]
    result = CliRunner().invoke(app, ["diagnose", str(log), *place, "-o", str(out)])
    assert result.exit_code == 0, result.stderr
    gravity = load_calibration(out).gravity
    assert abs(gravity.value - 9.81884) < 1e-4
    again = tmp_path / "again.json"
    CliRunner().invoke(app, ["diagnose", str(log), "--calibration", str(out), "-o", str(again)])
    assert load_calibration(again).gravity == gravity
    both = CliRunner().invoke(app, ["diagnose", str(log), "--gravity", "9.81", *place])
    assert both.exit_code == 2


@pytest.mark.long
def test_a_pipe_is_diagnosed_as_the_file_is(
    log: Path, diagnosed: tuple[str, Path], tmp_path: Path
) -> None:
    pipe = tmp_path / "log.arrow"
    os.mkfifo(pipe)
    writer = threading.Thread(target=lambda: pipe.write_bytes(log.read_bytes()), daemon=True)
    writer.start()
    piped = CliRunner().invoke(app, ["diagnose", str(pipe), "--json"])
    writer.join(timeout=10)
    assert piped.exit_code == 0, piped.stderr
    assert piped.stdout == diagnosed[0]


def test_it_is_interrupted_cleanly(log: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("calib.mismatch.diagnose_thinned", interrupted)
    result = CliRunner().invoke(app, ["diagnose", str(log), "--json"])
    assert result.exit_code == 130
    assert result.stdout == ""
    assert "Traceback" not in result.stderr


@pytest.mark.long
def test_a_simulation_in_a_csv_of_other_units_is_read_by_a_profile_of_its_own(
    log: Path, tmp_path: Path
) -> None:
    """Without temperature, at another rate, and its clock started minutes before."""
    rng = np.random.default_rng(5)
    motion = bench_protocol(rng, poses=12, first_pose=2.0, pose_duration=(3.0, 4.0))
    sim = simulate(motion, SensorModel(), NoiseModel(), rng=rng, rate=80.0)
    table = np.column_stack((sim.time + 431.7, sim.accel / 9.80665, np.degrees(sim.gyro)))
    path, profile = tmp_path / "sim.csv", tmp_path / "sim.toml"
    names = ("t", "fx", "fy", "fz", "wx", "wy", "wz")
    np.savetxt(path, table, delimiter=",", header=",".join(names), comments="", fmt="%.9g")
    profile.write_text(
        "[text]\ndelimiter = ','\nheader = true\n"
        "[time]\ncolumn = 't'\nunit = 's'\n"
        "[accel]\ncolumns = ['fx', 'fy', 'fz']\nunit = 'g'\n"
        "[gyro]\ncolumns = ['wx', 'wy', 'wz']\nunit = 'deg/s'\n"
    )
    args = ["diagnose", str(log), "--against", str(path), "--json"]
    result = CliRunner().invoke(app, [*args, "--other-profile", str(profile)])
    assert result.exit_code == 0, result.output
    document = json.loads(result.stdout)
    assert [f["effect"] for f in document["findings"]] == ["gyro_misalignment"]


def test_a_profile_of_what_it_is_not_compared_with_is_refused(log: Path) -> None:
    result = CliRunner().invoke(app, ["diagnose", str(log), "--other-profile", "mpu9150"])
    assert result.exit_code == 2
    assert "--against" in result.output


@pytest.mark.parametrize("option", ["--output", "--report"])
def test_where_nothing_can_be_written_is_said_before_the_recording_is_read(
    tmp_path: Path, option: str
) -> None:
    args = ["diagnose", str(tmp_path / "none.csv"), option, str(tmp_path / "no" / "made")]
    result = CliRunner().invoke(app, args)
    assert result.exit_code == 10
    assert "cannot write it: No such file or directory" in " ".join(result.stderr.split())
    assert os.listdir(tmp_path) == []


def test_a_reference_that_is_given_as_a_simulation_is_sent_to_its_option(
    log: Path, tmp_path: Path
) -> None:
    path = tmp_path / "table.csv"
    path.write_text("time,angle_deg\n0,0\n1,90\n2,90\n3,0\n")
    for args in ([str(log), "--against", str(path)], [str(path)]):
        result = CliRunner().invoke(app, ["diagnose", *args])
        assert result.exit_code == 3
        assert "--reference table.csv" in " ".join(result.stderr.split())
