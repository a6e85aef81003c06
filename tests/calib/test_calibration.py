"""The calibration document: round trips, its schema, and what it refuses."""

import json
from copy import deepcopy
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import calib
from calib.calibration import (
    Calibration,
    Event,
    Gravity,
    Housing,
    InputFile,
    Noise,
    PoseTable,
    Provenance,
    Quantity,
    TemperatureRange,
    TriadSummary,
)
from calib.document import BASELINE, from_document, to_document
from calib.effects.base import State, Term
from calib.errors import CalibrationFileError
from calib.fit import Exclusion
from calib.gravity import EARTH
from calib.model import SensorModel, Triad
from calib.plausible import BIAS, TEMPERATURE
from calib.recording import DeviceInfo
from calib.rotation import mat_from_rotvec

SCHEMA = json.loads(
    (Path(calib.__file__).parent / "schemas/calibration.schema.json").read_text(encoding="utf-8")
)


def example(seed: int = 0, *, full: bool = True) -> Calibration:
    rng = np.random.default_rng(seed)
    lower = np.tril(rng.normal(0, 0.01, (3, 3)), -1)
    off_diagonal = rng.normal(0, 0.01, (3, 3)) * (1 - np.eye(3))
    term = Term("gyro_g_sensitivity", {"gxx": 1e-4, "gzy": -2e-4})
    model = SensorModel(
        Triad(rng.normal(0, 0.2, 3), rng.normal(0, 0.02, 3), lower),
        Triad(rng.normal(0, 0.02, 3), rng.normal(0, 0.02, 3), off_diagonal),
        (term,) if full else (),
        31.5,
    )
    names = tuple(
        n for n in BASELINE if n not in {f"accel.misalignment.{p}" for p in ["xy", "xz", "yz"]}
    )
    undetermined = ("gyro.scale_factor_error.z", "gyro.misalignment.zx")
    names = tuple(n for n in names if n not in undetermined)
    if full:
        names += ("gyro_g_sensitivity.gxx", "gyro_g_sensitivity.gzy")
    root = rng.normal(0, 1e-3, (len(names), len(names)))
    k = 5
    interval = np.sort(rng.uniform(0, 100, (k, 2)), axis=1)
    summary = TriadSummary(
        "maximum_likelihood",
        rng.normal(0, 1e-3, (k, 1)),
        "m/s²",
        interval,
        11,
        14.2,
        (Exclusion((1.0, 2.0), 0.0, "bumped: 9 standard errors"),),
        ("turn about z",),
    )
    return Calibration(
        model,
        names,
        root @ root.T,
        undetermined,
        Gravity(9.8066, "latitude 45°", 1e-4),
        accel=summary,
        gyro=summary if full else None,
        temperature=TemperatureRange(20.0, 33.0) if full else None,
        noise=Noise(100.0, np.full(3, 1e-3), np.full(3, 1e-4)) if full else None,
        poses=PoseTable(interval, rng.normal(0, 9, (k, 3)), rng.normal(0, 1, (k, 3)), None),
        housing=Housing(mat_from_rotvec(np.array([0.01, 0.02, 1.0])), np.full(3, 1e-4), 1e-3, 6)
        if full
        else None,
        events=(
            Event(
                "gyro_bias_step",
                ("gyro.x",),
                ((10.0, 11.0),),
                {"step": Quantity(0.01, 0.001, "rad/s"), "time": Quantity(10.5, None, "s")},
            ),
        ),
        provenance=Provenance(
            (InputFile("a.arrow", "0" * 64),),
            "0.1.0",
            "2026-01-02T03:04:05+00:00",
            DeviceInfo("mpu6050", "SN 7", accel_full_scale=19.6, rate=100.0),
            {"operator": "Å"},
        ),
    )


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.booleans())
def test_a_document_comes_back_as_it_was(seed: int, full: bool) -> None:
    document = to_document(example(seed, full=full))
    text = json.dumps(document, allow_nan=False)
    again = from_document(json.loads(text))
    assert to_document(again) == document
    jsonschema.validate(document, SCHEMA)


def test_correct_of_a_document_is_that_of_the_original() -> None:
    calibration = example()
    again = from_document(to_document(calibration))
    rng = np.random.default_rng(1)
    state = State(np.arange(4.0), rng.normal(0, 9, (4, 3)), rng.normal(0, 1, (4, 3)))
    before, after = calibration.correct(state), again.correct(state)
    np.testing.assert_array_equal(before.accel, after.accel)
    np.testing.assert_array_equal(before.gyro, after.gyro)
    # into the housing: vec_h = mat_hs @ vec_s
    inner = calibration.model.correct(state)
    assert calibration.housing is not None
    np.testing.assert_allclose(after.accel[2], calibration.housing.mat_hs @ inner.accel[2])


def test_status_tells_determined_from_undetermined_and_fixed() -> None:
    calibration = from_document(to_document(example()))
    assert calibration.status("accel.bias.x") == "determined"
    assert calibration.status("gyro.misalignment.zx") == "undetermined"
    assert calibration.status("accel.misalignment.xy") == "fixed"
    assert not calibration.complete
    assert calibration.sigmas["accel.bias.x"] == pytest.approx(calibration.covariance[0, 0] ** 0.5)


def test_a_newer_minor_version_loads_and_keeps_what_it_adds() -> None:
    document = to_document(example())
    document["version"] = "1.7"
    document["allan"] = {"tau": [1, 2]}
    document["accel"]["novelty"] = 1
    again = from_document(document)
    assert again.version == "1.7"
    assert again.extra == {"allan": {"tau": [1, 2]}}
    assert to_document(again)["allan"] == {"tau": [1, 2]}
    jsonschema.validate(document, SCHEMA)


def damage(path: str, value: object) -> dict:
    document = deepcopy(to_document(example()))
    node = document
    *parents, last = path.split("/")
    for key in parents:
        node = node[int(key)] if isinstance(node, list) else node[key]
    if value is KeyError:
        del node[last]
    else:
        node[last] = value
    return document


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("format", "imucal", "expected 'imu-cal/calibration'"),
        ("format", KeyError, "expected 'imu-cal/calibration'"),
        ("version", "2.0", "reads version 1.x"),
        ("version", "one", "expected one like '1.0'"),
        ("version", 1.0, "must be a string"),
        ("parameters/accel.bias.x/unit", "mg", "unit 'mg', expected 'm/s²'"),
        ("parameters/gyro.bias.x/unit", "deg/s", "unit 'deg/s', expected 'rad/s'"),
        ("parameters/gyro.bias.x", KeyError, "lacks `parameters.gyro.bias.x`"),
        ("parameters/gyro.bias.x/value", "0.1", "must be a finite number"),
        ("parameters/gyro.bias.x/value", None, "must be a finite number"),
        ("parameters/gyro.bias.x/value", True, "must be a finite number"),
        ("parameters", [], "`parameters` must be an object"),
        ("gravity/unit", "g", "unit 'g', expected 'm/s²'"),
        ("reference_temperature/unit", "K", "expected '°C'"),
        ("temperature_range/unit", "°F", "expected '°C'"),
        ("covariance/values", [[1.0]], "must be 21 x 21 numbers"),
        ("covariance/values", "none", "must be numbers"),
        ("covariance/names", ["accel.bias.x"], "units are"),
        ("covariance/names", ["accel.offset.x"] * 21, "accel.offset"),
        ("covariance", KeyError, "lacks `covariance`"),
        ("terms/0/effect", "gyro_magic", "knows no effect 'gyro_magic'"),
        ("terms/0/parameters/gxx/unit", "dps/g", "expected '(rad/s)/(m/s²)'"),
        ("accel/intervals/unit", "ms", "expected 's'"),
        ("accel/residuals/values", [[1.0], [1.0, 2.0]], "must be numbers"),
        ("housing/mat_hs/values", [[1, 0, 0], [0, 1, 0], [0, 0, -1]], "no rotation matrix"),
        ("noise/gyro/unit", "dps/√Hz", "expected 'rad/s/√Hz'"),
        ("provenance/notes", {"operator": 3}, "must be a string"),
        ("provenance/device/rate", {"value": 100.0, "unit": "kHz"}, "expected 'Hz'"),
    ],
)
def test_a_damaged_document_is_refused_with_the_place(
    path: str, value: object, message: str
) -> None:
    with pytest.raises(CalibrationFileError) as caught:
        from_document(damage(path, value))
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        *((("gravity/value"), g, "as on Earth") for g in (-9.8, 0, 1, 98.0, 9.7, 9.9)),
        ("gravity/sigma", -1e-4, "`gravity.sigma` must be 0 or more"),
        ("parameters/accel.bias.x/value", 1e30, "`parameters.accel.bias` has 1e+30 m/s²"),
        ("parameters/accel.bias.x/value", -101.0, "expected 100 at most"),
        ("parameters/gyro.bias.y/value", 11.0, "expected 10 at most"),
        ("parameters/gyro.bias.y/sigma", -1e-5, "must be 0 or more"),
        ("parameters/accel.scale_factor_error.x/value", -1.0, "read 0 of 1 in some direction"),
        ("parameters/gyro.scale_factor_error.z/value", -0.95, "relative (0.01 is 1 %)"),
        ("parameters/gyro.scale_factor_error.z/value", 16384.0, "expected 0.1 to 10"),
        ("parameters/gyro.misalignment.xy/value", 1e30, "expected 0.1 to 10"),
        ("terms/0/parameters/gxx/value", 1e3, "`gxx` of gyro_g_sensitivity is 1000"),
        ("terms/0/parameters/gxx/sigma", -1e-9, "must be 0 or more"),
        ("reference_temperature/value", 1e3, "`reference_temperature` is 1000 °C"),
        ("temperature_range/low", -300.0, "`temperature_range.low` is -300 °C"),
        ("temperature_range/low", 40.0, "expected the lower one first"),
        ("noise/rate/value", 0.0, "expected a rate above 0"),
        ("noise/gyro/noise_density", [1e-4, -1e-4, 1e-4], "densities of 0 or more"),
        ("housing/sigma/values", [1e-4, -1e-4, 1e-4], "must be 0 or more"),
        ("events/0/parameters/step/sigma", -0.1, "must be 0 or more"),
        ("accel/excluded/0/weight", -1.0, "must be 0 or more"),
    ],
)
def test_a_calibration_of_no_sensor_on_earth_is_refused(
    path: str, value: object, message: str
) -> None:
    document = damage(path, value)
    with pytest.raises(CalibrationFileError) as caught:
        from_document(document)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("gravity/value", 9.764),
        ("gravity/value", 9.834),
        ("parameters/accel.bias.x/value", 20.0),
        ("parameters/accel.scale_factor_error.x/value", -2.0),
        ("parameters/accel.scale_factor_error.x/value", 7.0),
        ("parameters/gyro.misalignment.xy/value", 0.5),
    ],
)
def test_a_bad_sensor_on_earth_is_read(path: str, value: object) -> None:
    document = damage(path, value)
    from_document(document)
    jsonschema.validate(document, SCHEMA)


@pytest.mark.parametrize(
    ("path", "value"),
    [
        *(("gravity/value", edge) for edge in EARTH),
        *((f"parameters/{t}.bias.x/value", s * 1.001 * BIAS[t][0]) for t in BIAS for s in (-1, 1)),
        *(("reference_temperature/value", 1.001 * edge) for edge in TEMPERATURE),
        *(("temperature_range/high", 1.001 * edge) for edge in TEMPERATURE),
    ],
)
def test_the_schema_has_the_bounds_of_the_reader(path: str, value: object) -> None:
    document = damage(path, value)
    with pytest.raises(CalibrationFileError):
        from_document(document)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(document, SCHEMA)


@pytest.mark.parametrize("content", [None, [], "text", 3, {}])
def test_what_is_no_calibration_at_all(content: object) -> None:
    with pytest.raises(CalibrationFileError):
        from_document(content)


def test_a_covariance_that_is_none_is_refused() -> None:
    document = to_document(example())
    document["covariance"]["values"][0][0] = -1.0
    with pytest.raises(CalibrationFileError, match="negative variance"):
        from_document(document)
    document = to_document(example())
    document["covariance"]["values"][0][1] += 1.0
    with pytest.raises(CalibrationFileError, match="symmetric"):
        from_document(document)


def test_standard_errors_that_were_typed_in_count_though_no_covariance_has_them() -> None:
    document = to_document(example())
    whole = from_document(document)
    kept = [i for i, n in enumerate(document["covariance"]["names"]) if n.startswith("accel")]
    own = document["covariance"]
    document["covariance"] = {
        "names": [own["names"][i] for i in kept],
        "units": [own["units"][i] for i in kept],
        "values": [[own["values"][i][j] for j in kept] for i in kept],
    }
    read = from_document(document)
    assert set(read.names) == set(whole.names)
    assert read.sigmas == pytest.approx(whole.sigmas)
    alone = [i for i, n in enumerate(read.names) if not n.startswith("accel")]
    others = np.delete(np.delete(read.covariance, kept, 0), kept, 1) if alone else read.covariance
    np.testing.assert_array_equal(others, np.diag(np.diag(others)))
