"""``imu-cal show``: a table that fits 80 columns, the document, the schema."""

import json
from dataclasses import replace
from pathlib import Path

import jsonschema
import numpy as np
from typer.testing import CliRunner

from calib.calibration import Calibration, Gravity
from calib.effects.base import Term
from calib.model import SensorModel, Triad
from drivers.calibration_file import save_calibration
from imu_cli.app import app

CALIBRATION = Calibration(
    SensorModel(
        Triad(np.array([0.0980665, 0.0, 0.0])),
        Triad(np.radians([0.5, 0.0, 0.0])),
        (
            Term("gyro_g_sensitivity", {"gxx": 1e-4}),
            Term("bandwidth", {"gyro": 1.0, "gyro_cutoff": 42.0, "order": 1.0}),
        ),
    ),
    ("accel.bias.x", "gyro.bias.x", "gyro_g_sensitivity.gxx", "bandwidth.gyro_cutoff"),
    np.diag([1e-6, 1e-8, 1e-12, 4.0]),
    ("gyro.scale_factor_error.z",),
    Gravity(9.80665),
)


def test_table_in_si_and_everyday_units(tmp_path: Path) -> None:
    path = tmp_path / "a.cal.json"
    save_calibration(CALIBRATION, path)
    result = CliRunner().invoke(app, ["show", str(path)], env={"COLUMNS": "80"})
    assert result.exit_code == 0
    text = result.stdout
    assert max(map(len, text.splitlines())) <= 80
    assert "0.0981 ± 0.0010" in text
    assert "10.00 ± 0.10" in text  # mg
    assert "0.5000 ± 0.0057" in text  # degrees a second
    assert "gyro_g_sensitivity.gxx" in text
    assert "gyro.scale_factor_error  z" in text
    assert "42.0 ± 2.0" in text
    assert "presence" not in text
    assert "…" not in text


def test_names_and_people_s_units_are_whole_at_80_columns(tmp_path: Path) -> None:
    """A scale factor's name was broken inside, and terms had no people's unit."""
    path = tmp_path / "a.cal.json"
    names = (*CALIBRATION.names, "accel.scale_factor_error.x")
    covariance = np.diag([1e-6, 1e-8, 1e-12, 4e4, 1e-10])
    save_calibration(replace(CALIBRATION, names=names, covariance=covariance), path)
    result = CliRunner().invoke(app, ["show", str(path)], env={"COLUMNS": "80"})
    rows = {line.split()[0]: line for line in result.stdout.splitlines() if line.strip()}
    assert max(map(len, rows.values())) <= 80
    assert "0.0000 ± 0.0010 %" in rows["accel.scale_factor_error.x"]
    assert "0.05619 ± 0.00056 dps/g" in rows["gyro_g_sensitivity.gxx"]
    assert "42 ± 200 Hz" in rows["bandwidth.gyro_cutoff"]


def test_json_is_the_document_and_obeys_the_schema(tmp_path: Path) -> None:
    path = tmp_path / "a.cal.json"
    save_calibration(CALIBRATION, path)
    document = json.loads(CliRunner().invoke(app, ["show", str(path), "--json"]).stdout)
    schema = json.loads(CliRunner().invoke(app, ["show", "--schema"]).stdout)
    jsonschema.validate(document, schema)
    assert document == json.loads(path.read_text(encoding="utf-8"))


def test_what_cannot_be_shown(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["show", str(tmp_path / "none.json")])
    assert result.exit_code == 10
    assert "cannot read it" in result.stderr
    assert CliRunner().invoke(app, ["show"]).exit_code == 2
    assert "Traceback" not in result.stderr
