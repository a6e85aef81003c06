"""``imu-cal verify`` and ``imu-cal compare``: the words, the JSON, the exit codes."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from calib.calibration import Calibration
from drivers.calibration_file import load_calibration, save_calibration
from drivers.formats import read_recording, write_recording
from imu_cli.app import app

FIXTURES = Path(__file__).resolve().parents[2] / "fixtures"
BENCH = FIXTURES / "bench.csv"


def run(*args: object) -> tuple[int, str, str]:
    result = CliRunner().invoke(app, list(map(str, args)), env={"COLUMNS": "80"})
    assert result.exception is None or isinstance(result.exception, SystemExit)
    return result.exit_code, result.stdout, " ".join(result.stderr.split())


@pytest.fixture(scope="module")
def cal(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("cal") / "bench.cal.json"
    assert run("calibrate", BENCH, "-o", path)[0] == 0
    return path


def shifted(cal: Path, out: Path, name: str, by: float) -> Calibration:
    known = load_calibration(cal)
    triad = name.split(".")[0]
    old = getattr(known.model, triad)
    moved = old.with_parameters({name: old.parameters(triad)[name] + by})
    changed = replace(known, model=replace(known.model, **{triad: moved}))
    save_calibration(changed, out)
    return changed


def test_a_calibration_is_right_for_its_own_log(cal: Path) -> None:
    code, said, _ = run("verify", cal, BENCH)
    assert code == 0
    assert "is right for this recording" in said
    code, said, _ = run("verify", cal, BENCH, "--json")
    answer = json.loads(said)
    assert (code, answer["right"], answer["format"]) == (0, True, "imu-cal/verification")
    assert [check["name"] for check in answer["checks"]] == ["gravity", "rest", "turns"]


@pytest.mark.parametrize(
    ("name", "by", "check"),
    [("accel.bias.x", 0.03, "gravity"), ("gyro.scale_factor_error.y", 0.01, "turns")],
)
def test_what_changed_is_named_and_the_exit_code_is_6(
    cal: Path, tmp_path: Path, name: str, by: float, check: str
) -> None:
    shifted(cal, tmp_path / "b.json", name, by)
    code, said, _ = run("verify", tmp_path / "b.json", BENCH)
    assert code == 6
    assert "NOT right" in said
    assert name in said
    code, said, _ = run("verify", tmp_path / "b.json", BENCH, "--json")
    assert code == 6
    failed = [item["name"] for item in json.loads(said)["checks"] if not item["right"]]
    assert check in failed
    code, said, _ = run("compare", cal, tmp_path / "b.json")
    assert code == 6
    assert max(map(len, said.splitlines())) <= 80
    assert [line.split()[0] for line in said.splitlines() if "changed" in line] == [name]
    code, said, _ = run("compare", cal, tmp_path / "b.json", "--json")
    parameter = json.loads(said)["parameters"][name]
    assert parameter["changed"]
    assert parameter["difference"] == pytest.approx(by)


def test_the_same_calibration_is_the_same(cal: Path) -> None:
    code, said, _ = run("compare", cal, cal)
    assert code == 0
    assert said.rstrip().endswith("the same")


def test_what_only_one_has_is_not_said_to_be_the_same(cal: Path, tmp_path: Path) -> None:
    known = load_calibration(cal)
    names = known.names[:-1]
    less = replace(known, names=names, covariance=known.covariance[:-1, :-1])
    save_calibration(less, tmp_path / "less.json")
    code, said, _ = run("compare", cal, tmp_path / "less.json")
    assert code == 0
    assert f"{cal} determines {known.names[-1]}" in said.replace("\n", "")
    assert said.rstrip().endswith("the same in what both have")


def test_another_device_and_a_newer_version_are_said(cal: Path, tmp_path: Path) -> None:
    recording = read_recording(BENCH)
    other = replace(recording, device=replace(recording.device, serial_number="other"))
    write_recording(other, tmp_path / "other.arrow")
    code, _, warned = run("verify", cal, tmp_path / "other.arrow")
    assert code == 0
    assert "the serial number is other" in warned
    document = json.loads(cal.read_text(encoding="utf-8"))
    document |= {"version": "1.9", "allan": {}}
    (tmp_path / "new.json").write_text(json.dumps(document), encoding="utf-8")
    code, _, warned = run("show", tmp_path / "new.json")
    assert code == 0
    assert "has version 1.9" in warned
    assert "allan" in warned


@pytest.mark.parametrize(
    ("args", "code", "message"),
    [
        (("verify", "none.json", BENCH), 10, "cannot read it"),
        (("compare", BENCH, BENCH), 10, "not JSON"),
        (("verify", "CAL", "none.csv"), 3, "no file"),
        (("verify", "CAL", FIXTURES / "bad" / "only_motion.csv"), 4, "no static pose"),
        (("verify", "CAL", FIXTURES / "bad" / "accel_in_g.csv"), 3, "in g"),
        (("verify", "CAL", BENCH, "--significance", "2"), 2, "between 0 and 1"),
    ],
)
def test_what_cannot_be_judged(cal: Path, args: tuple, code: int, message: str) -> None:
    found, said, warned = run(*(cal if item == "CAL" else item for item in args))
    assert found == code
    assert message in warned
    assert not said


def test_a_corrected_recording_is_no_evidence(cal: Path, tmp_path: Path) -> None:
    out = tmp_path / "corrected.arrow"
    assert run("apply", cal, BENCH, "-o", out)[0] == 0
    code, _, warned = run("verify", cal, out)
    assert code == 3
    assert "already" in warned
    code, _, warned = run("calibrate", out, "-o", tmp_path / "again.json")
    assert code == 0
    assert "was corrected by bench.cal.json" in warned
    left = load_calibration(tmp_path / "again.json")
    assert all(abs(left.values[name]) < 1e-5 + left.sigmas[name] for name in left.names)


def test_one_pose_only_is_enough_to_begin(cal: Path) -> None:
    code, said, _ = run("verify", cal, FIXTURES / "bad" / "one_pose.csv", "--json")
    answer = json.loads(said)
    assert answer["comparison"] is None or not answer["comparison"]["parameters"].keys() - {
        f"gyro.bias.{a}" for a in "xyz"
    }
    assert code == (0 if answer["right"] else 6)
    assert np.isfinite([check["p_value"] for check in answer["checks"]]).all()
    assert [item["name"] for item in answer["not_tested"]] == ["turns"]
    said = run("verify", cal, FIXTURES / "bad" / "one_pose.csv")[1]
    assert "turns    not tested: the recording has no turn" in said
    assert "as to gravity and rest; turns: not tested" in said


def test_a_model_that_diagnose_wrote_is_tested_over_turns(tmp_path: Path) -> None:
    assert run("diagnose", BENCH, "-o", tmp_path / "found.json")[0] == 0
    code, said, _ = run("verify", tmp_path / "found.json", BENCH, "--json")
    answer = json.loads(said)
    assert code == 0
    assert [check["name"] for check in answer["checks"]] == ["gravity", "rest", "turns"]
    assert answer["not_tested"] == []
    shifted(tmp_path / "found.json", tmp_path / "b.json", "gyro.scale_factor_error.x", 0.01)
    code, said, _ = run("verify", tmp_path / "b.json", BENCH, "--json")
    assert code == 6
    assert [c["name"] for c in json.loads(said)["checks"] if not c["right"]] == ["turns"]
