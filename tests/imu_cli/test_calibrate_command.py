"""``imu-cal calibrate``: the good log, partial ones, every option, and every bad input."""

import json
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from typer.testing import CliRunner

from calib.document import schema
from calib.model import SensorModel
from calib.simulate import NoiseModel, simulate
from calib.simulation.turntable import turntable
from drivers.calibration_file import load_calibration
from drivers.formats import read_recording, write_recording
from imu_cli.app import app

FIXTURES = Path(__file__).resolve().parents[2] / "fixtures"
BENCH = FIXTURES / "bench.csv"


def run(*args: object) -> tuple[int, str, str]:
    result = CliRunner().invoke(app, ["calibrate", *map(str, args)], env={"COLUMNS": "80"})
    assert result.exception is None or isinstance(result.exception, SystemExit)
    return result.exit_code, result.stdout, " ".join(result.stderr.split())


def test_the_good_log_gives_its_truth_and_says_where_from(tmp_path: Path) -> None:
    out = tmp_path / "a.cal.json"
    code, said, warned = run(BENCH, "-o", out, "--note", "operator=Å", "--note", "fixture=7")
    assert code == 0
    assert not warned
    assert max(map(len, said.splitlines())) <= 100
    document = json.loads(out.read_text(encoding="utf-8"))
    jsonschema.validate(document, schema())
    truth = json.loads((FIXTURES / "bench.truth.json").read_text(encoding="utf-8"))
    found = load_calibration(out)
    assert found.complete
    values, sigmas = found.values, found.sigmas
    known = {name: value for name, value in truth["parameters"].items() if name in sigmas}
    assert len(known) == 21
    for name, value in known.items():
        assert abs(values[name] - value) < 4.5 * sigmas[name], name
    source = found.provenance
    assert source.notes == {"operator": "Å", "fixture": "7"}
    assert source.inputs[0].name == "bench.csv"
    assert source.inputs[0].sha256 in (FIXTURES / "README.md").read_text(encoding="utf-8")
    assert source.device.chip == "MPU-6050"
    assert source.date
    assert source.tool_version


def test_json_is_one_document_and_the_default_name_stands_beside_the_log(tmp_path: Path) -> None:
    log = tmp_path / "run 7.arrow"
    write_recording(read_recording(BENCH), log)
    code, said, _ = run(log, "--json")
    assert code == 0
    assert json.loads(said) == json.loads((tmp_path / "run 7.cal.json").read_text("utf-8"))


def test_one_file_per_pose_gives_a_partial_calibration(tmp_path: Path) -> None:
    recording = read_recording(BENCH)
    run(BENCH, "-o", tmp_path / "whole.json")
    poses = load_calibration(tmp_path / "whole.json").poses
    assert poses is not None
    logs = []
    for k, (a, b) in enumerate(poses.interval):
        first, last = np.searchsorted(recording.time, [a, b])
        logs.append(tmp_path / f"pose{k:02}.csv")
        write_recording(recording.slice(int(first), int(last)), logs[-1])
    out = tmp_path / "poses.json"
    code, said, _ = run(*logs, "-o", out)
    assert code == 5
    assert "not determined" in said
    found = load_calibration(out)
    assert {f"gyro.scale_factor_error.{a}" for a in "xyz"} <= set(found.undetermined)
    assert {f"gyro.bias.{a}" for a in "xyz"} <= set(found.names)
    assert not any(name.startswith("accel") for name in found.undetermined)
    assert len(found.provenance.inputs) == len(poses.interval)


@pytest.mark.parametrize("method", ["exact", "published"])
def test_accel_methods_agree(tmp_path: Path, method: str) -> None:
    assert run(BENCH, "-o", tmp_path / "a.json")[0] == 0
    assert run(BENCH, "-o", tmp_path / "b.json", "--accel-method", method)[0] == 0
    one, two = (load_calibration(tmp_path / f"{x}.json") for x in "ab")
    assert two.accel is not None
    assert two.accel.method == method
    np.testing.assert_allclose(one.model.accel.matrix, two.model.accel.matrix, atol=2e-3)


@pytest.mark.parametrize("method", ["euler", "quaternion", "rotation_segment"])
def test_gyro_methods_of_the_paper_fix_the_misalignment_at_zero(
    tmp_path: Path, method: str
) -> None:
    code, _, _ = run(BENCH, "-o", tmp_path / "a.json", "--gyro-method", method)
    found = load_calibration(tmp_path / "a.json")
    assert code in (0, 5)
    assert found.gyro is not None
    assert found.gyro.method == method
    assert not any(name.startswith("gyro.misalignment") for name in found.names)


def test_gravity_by_place_scales_the_accelerometer(tmp_path: Path) -> None:
    assert run(BENCH, "-o", tmp_path / "a.json", "--gravity", 9.81)[0] == 0
    assert run(BENCH, "-o", tmp_path / "b.json", "--latitude", 0, "--height", 0)[0] == 0
    one, two = (load_calibration(tmp_path / f"{x}.json") for x in "ab")
    assert two.gravity.value == pytest.approx(9.7803253359)
    assert "0°" in two.gravity.source
    assert two.gravity.sigma > 0
    ratio = one.model.accel.matrix[0, 0] / two.model.accel.matrix[0, 0]
    assert ratio == pytest.approx(9.7803253359 / 9.81, rel=1e-7)


def test_housing_faces_turn_the_result_into_the_housing(tmp_path: Path) -> None:
    assert run(BENCH, "-o", tmp_path / "a.json")[0] == 0
    plain = load_calibration(tmp_path / "a.json")
    assert plain.poses is not None
    true = plain.model.accel.correct(plain.poses.accel)
    names = [
        f"{'+' if row[k] > 0 else '-'}{'XYZ'[k]}"
        for row, k in zip(true, np.argmax(abs(true), axis=1), strict=True)
    ]
    near = [k for k in range(len(true)) if abs(true[k]).max() > 9.8065 * np.cos(np.radians(25))]
    faces = tmp_path / "faces.csv"
    rows = [f"{plain.poses.interval[k].mean():.2f},{names[k]}" for k in near]
    faces.write_text("# which face was up\ntime,up\n" + "\n".join(rows) + "\n", encoding="utf-8")
    code, said, _ = run(BENCH, "-o", tmp_path / "b.json", "--housing-faces", faces)
    assert code == 0
    assert "housing" in said
    housing = load_calibration(tmp_path / "b.json").housing
    assert housing is not None
    assert housing.poses == len(near)
    wrong = faces.read_text(encoding="utf-8").replace("-X", "+Q")
    faces.write_text(wrong, encoding="utf-8")
    code, _, warned = run(BENCH, "-o", tmp_path / "c.json", "--housing-faces", faces)
    assert code == 3
    assert "up is '+Q'" in warned
    assert not (tmp_path / "c.json").exists()


@pytest.mark.parametrize(
    ("name", "code", "message"),
    [
        ("empty.csv", 3, "empty"),
        ("header_only.csv", 3, "no samples"),
        ("letter.csv", 3, "no log"),
        ("binary.csv", 3, "binary"),
        ("folder.csv", 3, "folder"),
        ("there is none.csv", 3, "no file"),
        ("nan_row.csv", 3, "line 69: gyro.y is nan"),
        ("infinite_row.csv", 3, "line 152: accel.y is inf"),
        ("time_backwards.csv", 3, "time does not increase"),
        ("time_repeated.csv", 3, "time does not increase"),
        ("accel_in_g.csv", 3, "in g"),
        ("accel_in_mg.csv", 3, "in mg"),
        ("gyro_in_degrees.csv", 3, "deg/s"),
        ("one_pose.csv", 4, "one pose only"),
        ("only_motion.csv", 4, "never at rest"),
        ("missing_column.csv", 3, "gyro_z"),
        ("word.csv", 3, "line 132"),
        ("ragged.csv", 3, "line 112"),
        ("no_names.log", 3, "--profile"),
    ],
)
def test_bad_input_is_refused_in_its_own_words_and_leaves_no_file(
    tmp_path: Path, name: str, code: int, message: str
) -> None:
    out = tmp_path / "a.cal.json"
    found, said, warned = run(FIXTURES / "bad" / name, "-o", out)
    assert found == code
    assert message in warned
    assert not said
    assert list(tmp_path.iterdir()) == []


def test_what_was_cut_is_said_and_used(tmp_path: Path) -> None:
    text = BENCH.read_bytes()
    (tmp_path / "cut.csv").write_bytes(text[: text.rindex(b",")])
    code, _, warned = run(tmp_path / "cut.csv")
    assert code == 0
    assert "cut" in warned
    assert load_calibration(tmp_path / "cut.cal.json").complete


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--accel-method", "magic"], "is none of"),
        (["--gyro-method", "magic"], "is none of"),
        (["--gravity", "1"], "between 9.7 and 9.9"),
        (["--gravity", "9.8", "--latitude", "3"], "not both"),
        (["--height", "3"], "--latitude"),
        (["--latitude", "91"], "within ±90°"),
        (["--note", "nothing"], "KEY=VALUE"),
        (["--gyro-method", "rate_table"], "--table-rate"),
        (["--table-rate", "3"], "rate_table"),
        (["--gyro-method", "rate_table", "--table-rate", "fast"], "°/s"),
        (["--gyro-method", "rate_table", "--table-rate", "3,4"], "table_rate"),
        (["-o", str(BENCH)], "is the recording itself"),
        (["-o", "/no/such/folder/a.json"], "a folder that is there"),
    ],
)
def test_wrong_usage_names_the_option(tmp_path: Path, options: list[str], message: str) -> None:
    code, _, warned = run(BENCH, "-o", tmp_path / "a.json", *options)
    assert code == 2
    assert message in warned.replace("│", " ")
    assert list(tmp_path.iterdir()) == []


def test_a_fault_of_its_own_is_not_blamed_on_an_option(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*_: object, **__: object) -> None:
        raise ValueError("a fault of its own")

    monkeypatch.setattr("calib.calibrate.calibrate", fails)
    result = CliRunner().invoke(
        app, ["calibrate", str(BENCH), "-o", str(tmp_path / "a.json")], standalone_mode=False
    )
    assert type(result.exception) is ValueError


def test_a_table_rate_may_stand_in_a_file(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    motion = turntable((1.5, -1.5), faces=("+x", "+y", "+z"), offset=(0.0, 0.0, 0.0))
    noise = NoiseModel(accel_noise_density=2e-3, gyro_noise_density=2e-4)
    write_recording(
        simulate(motion, SensorModel(), noise, rng=rng, rate=50.0), tmp_path / "table.arrow"
    )
    rows = [
        f"{s.start + 3:.2f},{s.stop - 3:.2f},{np.degrees(1.5)}"
        for s in motion.segments
        if s.kind == "spin"
    ]
    rates = tmp_path / "rates.csv"
    rates.write_text("start,stop,rate\n" + "\n".join(rows) + "\n", encoding="utf-8")
    options = ["--gyro-method", "rate-table", "--table-rate", rates]
    assert run(tmp_path / "table.arrow", *options)[0] == 5
    found = load_calibration(tmp_path / "table.cal.json")
    assert found.gyro is not None
    assert found.gyro.method == "rate_table"
    assert {f"gyro.scale_factor_error.{a}" for a in "xyz"} <= set(found.names)
    rates.write_text("start,stop,rate\n1,2\n", encoding="utf-8")
    code, _, warned = run(tmp_path / "table.arrow", *options)
    assert code == 2
    assert "start,stop,rate" in warned
