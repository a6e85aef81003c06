"""A `Calibration` as a JSON document, and back: ``imu-cal/calibration`` version 1.

Every number stands beside its unit. The published schema is ``schemas/calibration.schema.json``.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from importlib import resources
from typing import Any

import numpy as np

from calib.calibration import (
    VERSION,
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
    parameter_unit,
)
from calib.effects import effects
from calib.effects.base import Term
from calib.errors import CalibrationFileError
from calib.fit import Exclusion
from calib.model import SensorModel, Triad
from calib.recording import DeviceInfo
from calib.types import FloatArray

FORMAT = "imu-cal/calibration"
EQUATION = "measured = (I + S + M) @ true + bias + further terms + noise"
BASELINE = tuple(Triad().parameters("accel") | Triad().parameters("gyro"))

_DEVICE_UNITS = {
    "accel_full_scale": "m/s²",
    "gyro_full_scale": "rad/s",
    "accel_lsb": "m/s²",
    "gyro_lsb": "rad/s",
    "rate": "Hz",
}
_KEYS = (
    "format",
    "version",
    "equation",
    "gravity",
    "reference_temperature",
    "temperature_range",
    "parameters",
    "terms",
    "covariance",
    "accel",
    "gyro",
    "noise",
    "poses",
    "housing",
    "events",
    "provenance",
)


def schema() -> dict[str, Any]:
    """Return the published JSON Schema of the document."""
    text = resources.files("calib").joinpath("schemas/calibration.schema.json").read_text("utf-8")
    published: dict[str, Any] = json.loads(text)
    return published


def to_document(calibration: Calibration) -> dict[str, Any]:
    """Return the calibration as a document that `json` can write."""
    values, sigmas = calibration.values, calibration.sigmas
    provenance = calibration.provenance

    def quantity(name: str) -> dict[str, Any]:
        return {
            "value": values[name],
            "sigma": sigmas.get(name),
            "unit": parameter_unit(name),
            "status": calibration.status(name),
        }

    return {
        "format": FORMAT,
        "version": calibration.version,
        "equation": EQUATION,
        "gravity": {
            "value": calibration.gravity.value,
            "sigma": calibration.gravity.sigma,
            "unit": "m/s²",
            "source": calibration.gravity.source,
        },
        "reference_temperature": {
            "value": calibration.model.reference_temperature,
            "unit": "°C",
        },
        "temperature_range": None
        if calibration.temperature is None
        else {**asdict(calibration.temperature), "unit": "°C"},
        "parameters": {name: quantity(name) for name in BASELINE},
        "terms": [
            {
                "effect": term.effect,
                "parameters": {name: quantity(f"{term.effect}.{name}") for name in term.parameters},
            }
            for term in calibration.model.terms
        ],
        "covariance": {
            "names": list(calibration.names),
            "units": [parameter_unit(name) for name in calibration.names],
            "values": calibration.covariance.tolist(),
        },
        "accel": _write_summary(calibration.accel),
        "gyro": _write_summary(calibration.gyro),
        "noise": _write_noise(calibration.noise),
        "poses": _write_poses(calibration.poses),
        "housing": _write_housing(calibration.housing),
        "events": [
            {
                "effect": event.effect,
                "channels": list(event.channels),
                "intervals": [list(interval) for interval in event.intervals],
                "parameters": {name: asdict(item) for name, item in event.parameters.items()},
            }
            for event in calibration.events
        ],
        "provenance": {
            "inputs": [asdict(item) for item in provenance.inputs],
            "tool_version": provenance.tool_version,
            "date": provenance.date,
            "device": _write_device(provenance.device),
            "notes": dict(provenance.notes),
        },
        **calibration.extra,
    }


def from_document(document: object) -> Calibration:
    """Return the calibration that a document holds.

    Raises
    ------
    CalibrationFileError
        If it is another format, of another major version, lacks a key, has another unit than
        expected, or contradicts itself; the message names the key.
    """
    node = _Node(document, "")
    if node.get("format") != FORMAT:
        raise CalibrationFileError(
            f"not a calibration: `format` is {node.get('format')!r}, expected {FORMAT!r}; "
            "give a file that `imu-cal calibrate` wrote"
        )
    version = _check_version(node.text("version"))
    try:
        return _read(node, version)
    except CalibrationFileError:
        raise
    except ValueError as error:  # what the classes check when they are made
        raise CalibrationFileError(f"the calibration contradicts itself: {error}") from error


def _check_version(version: str) -> str:
    major, _, minor = version.partition(".")
    if not (major.isdigit() and minor.isdigit()):
        raise CalibrationFileError(f"`version` is {version!r}, expected one like {VERSION!r}")
    if major != VERSION.split(".")[0]:
        raise CalibrationFileError(
            f"the calibration has version {version}; this imu-cal reads version "
            f"{VERSION.split('.')[0]}.x: use the imu-cal that wrote it, or a newer one"
        )
    return version


def _read(node: _Node, version: str) -> Calibration:
    values: dict[str, float] = {}
    undetermined: list[str] = []
    parameters = node.child("parameters")
    for name in BASELINE:
        _read_parameter(parameters.child(name), name, values, undetermined)
    terms = []
    for item in node.items("terms"):
        slug = item.text("effect")
        if slug not in effects():
            raise CalibrationFileError(
                f"{item.path}: this imu-cal knows no effect {slug!r}; use a newer imu-cal"
            )
        content = item.child("parameters")
        own: dict[str, float] = {}
        for name in content.mapping():
            full = f"{slug}.{name}"
            own[name] = _read_parameter(content.child(name), full, values, undetermined)
        terms.append(Term(slug, own))
    reference = node.child("reference_temperature").quantity("°C")
    triads = {
        triad: Triad().with_parameters(
            {n: v for n, v in values.items() if n.startswith(f"{triad}.")}
        )
        for triad in ("accel", "gyro")
    }
    names, covariance = _read_covariance(node.child("covariance"))
    gravity = node.child("gravity")
    temperature = node.optional("temperature_range")
    if temperature is not None:
        temperature.unit("°C")
    return Calibration(
        SensorModel(triads["accel"], triads["gyro"], tuple(terms), reference),
        names,
        covariance,
        tuple(undetermined),
        Gravity(gravity.quantity("m/s²"), gravity.text("source"), gravity.number("sigma")),
        accel=_read_summary(node.optional("accel")),
        gyro=_read_summary(node.optional("gyro")),
        temperature=None
        if temperature is None
        else TemperatureRange(temperature.number("low"), temperature.number("high")),
        noise=_read_noise(node.optional("noise")),
        poses=_read_poses(node.optional("poses")),
        housing=_read_housing(node.optional("housing")),
        events=tuple(_read_event(item) for item in node.items("events")),
        provenance=_read_provenance(node.child("provenance")),
        version=version,
        extra={k: v for k, v in node.mapping().items() if k not in _KEYS},
    )


def _read_parameter(
    node: _Node, name: str, values: dict[str, float], undetermined: list[str]
) -> float:
    try:
        unit = parameter_unit(name)
    except ValueError as error:
        raise CalibrationFileError(f"{node.path}: {error}") from error
    values[name] = node.quantity(unit)
    if node.get("status") == "undetermined":
        undetermined.append(name)
    return values[name]


def _read_covariance(node: _Node) -> tuple[tuple[str, ...], FloatArray]:
    names = node.texts("names")
    units = node.texts("units")
    try:
        expected = tuple(parameter_unit(name) for name in names)
    except ValueError as error:
        raise CalibrationFileError(f"{node.path}: {error}") from error
    if units != expected:
        raise CalibrationFileError(f"{node.path}: units are {units}, expected {expected}")
    return names, node.array("values", (len(names), len(names)))


def _write_summary(summary: TriadSummary | None) -> dict[str, Any] | None:
    if summary is None:
        return None
    return {
        "method": summary.method,
        "count": len(summary.residuals),
        "residual_rms": {"value": summary.residual_rms, "unit": summary.residual_unit},
        "degrees_of_freedom": summary.degrees_of_freedom,
        "condition_number": _finite(summary.condition_number),
        "residuals": {"values": summary.residuals.tolist(), "unit": summary.residual_unit},
        "intervals": {"values": summary.intervals.tolist(), "unit": "s"},
        "excluded": [
            {"interval": list(item.interval), "weight": item.weight, "reason": item.reason}
            for item in summary.excluded
        ],
        "advice": list(summary.advice),
    }


def _read_summary(node: _Node | None) -> TriadSummary | None:
    if node is None:
        return None
    residuals, intervals = node.child("residuals"), node.child("intervals")
    intervals.unit("s")
    condition = node.get("condition_number")
    return TriadSummary(
        node.text("method"),
        residuals.array("values", (None, None)),
        residuals.text("unit"),
        intervals.array("values", (None, 2)),
        int(node.number("degrees_of_freedom")),
        float("inf") if condition is None else node.number("condition_number"),
        tuple(
            Exclusion(item.pair("interval"), item.number("weight"), item.text("reason"))
            for item in node.items("excluded")
        ),
        node.texts("advice"),
    )


def _write_noise(noise: Noise | None) -> dict[str, Any] | None:
    if noise is None:
        return None
    return {
        "rate": {"value": noise.rate, "unit": "Hz"},
        "accel": {"noise_density": noise.accel.tolist(), "unit": "m/s²/√Hz"},
        "gyro": {"noise_density": noise.gyro.tolist(), "unit": "rad/s/√Hz"},
    }


def _read_noise(node: _Node | None) -> Noise | None:
    if node is None:
        return None
    accel, gyro = node.child("accel"), node.child("gyro")
    accel.unit("m/s²/√Hz")
    gyro.unit("rad/s/√Hz")
    return Noise(
        node.child("rate").quantity("Hz"),
        accel.array("noise_density", (3,)),
        gyro.array("noise_density", (3,)),
    )


def _write_poses(poses: PoseTable | None) -> dict[str, Any] | None:
    if poses is None:
        return None
    table = {
        "interval": {"values": poses.interval.tolist(), "unit": "s"},
        "accel": {"values": poses.accel.tolist(), "unit": "m/s²"},
        "gyro": {"values": poses.gyro.tolist(), "unit": "rad/s"},
    }
    if poses.temperature is not None:
        table["temperature"] = {"values": poses.temperature.tolist(), "unit": "°C"}
    return table


def _read_poses(node: _Node | None) -> PoseTable | None:
    if node is None:
        return None
    columns = {}
    for name, unit, width in (("interval", "s", 2), ("accel", "m/s²", 3), ("gyro", "rad/s", 3)):
        node.child(name).unit(unit)
        columns[name] = node.child(name).array("values", (None, width))
    temperature = node.optional("temperature")
    if temperature is not None:
        temperature.unit("°C")
    return PoseTable(
        columns["interval"],
        columns["accel"],
        columns["gyro"],
        None if temperature is None else temperature.array("values", (None,)),
    )


def _write_housing(housing: Housing | None) -> dict[str, Any] | None:
    if housing is None:
        return None
    return {
        "mat_hs": {"values": housing.mat_hs.tolist(), "unit": "1"},
        "sigma": {"values": housing.sigma.tolist(), "unit": "rad"},
        "residual_rms": {"value": housing.residual_rms, "unit": "rad"},
        "poses": housing.poses,
    }


def _read_housing(node: _Node | None) -> Housing | None:
    if node is None:
        return None
    node.child("mat_hs").unit("1")
    node.child("sigma").unit("rad")
    mat_hs = node.child("mat_hs").array("values", (3, 3))
    if not np.allclose(mat_hs @ mat_hs.T, np.eye(3), atol=1e-9) or np.linalg.det(mat_hs) < 0:
        raise CalibrationFileError(f"{node.path}.mat_hs is no rotation matrix: {mat_hs.tolist()}")
    return Housing(
        mat_hs,
        node.child("sigma").array("values", (3,)),
        node.child("residual_rms").quantity("rad"),
        int(node.number("poses")),
    )


def _read_event(node: _Node) -> Event:
    content = node.child("parameters")
    parameters = {}
    for name in content.mapping():
        item = content.child(name)
        sigma = None if item.get("sigma") is None else item.number("sigma")
        parameters[name] = Quantity(item.number("value"), sigma, item.text("unit"))
    intervals = node.array("intervals", (None, 2))
    return Event(
        node.text("effect"),
        node.texts("channels"),
        tuple((float(a), float(b)) for a, b in intervals),
        parameters,
    )


def _write_device(device: DeviceInfo) -> dict[str, Any]:
    out: dict[str, Any] = {}
    for item in fields(device):
        value = getattr(device, item.name)
        unit = _DEVICE_UNITS.get(item.name)
        out[item.name] = value if unit is None or value is None else {"value": value, "unit": unit}
    return out


def _read_provenance(node: _Node) -> Provenance:
    device = node.child("device")
    content: dict[str, Any] = {}
    for item in fields(DeviceInfo):
        unit = _DEVICE_UNITS.get(item.name)
        if unit is None:
            content[item.name] = device.text(item.name)
        elif device.get(item.name) is not None:
            content[item.name] = device.child(item.name).quantity(unit)
    notes = node.child("notes")
    return Provenance(
        tuple(InputFile(item.text("name"), item.text("sha256")) for item in node.items("inputs")),
        node.text("tool_version"),
        node.text("date"),
        DeviceInfo(**content),
        {name: notes.text(name) for name in notes.mapping()},
    )


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None


class _Node:
    """A place in a document, which checks what it holds and names itself in messages."""

    def __init__(self, content: object, path: str) -> None:
        self.content = content
        self.path = path

    def mapping(self) -> Mapping[str, Any]:
        if not isinstance(self.content, dict):
            raise self._error("an object", self.content)
        return self.content

    def get(self, key: str) -> Any:
        return self.mapping().get(key)

    def child(self, key: str) -> _Node:
        content = self.mapping()
        path = f"{self.path}.{key}" if self.path else key
        if key not in content:
            raise CalibrationFileError(f"the calibration lacks `{path}`: was the file edited?")
        return _Node(content[key], path)

    def optional(self, key: str) -> _Node | None:
        return None if self.get(key) is None else self.child(key)

    def items(self, key: str) -> list[_Node]:
        node = self.child(key)
        if not isinstance(node.content, list):
            raise node._error("a list", node.content)
        return [_Node(item, f"{node.path}[{k}]") for k, item in enumerate(node.content)]

    def text(self, key: str) -> str:
        node = self.child(key)
        if not isinstance(node.content, str):
            raise node._error("a string", node.content)
        return node.content

    def texts(self, key: str) -> tuple[str, ...]:
        items = self.items(key)
        for item in items:
            if not isinstance(item.content, str):
                raise item._error("a string", item.content)
        return tuple(str(item.content) for item in items)

    def number(self, key: str) -> float:
        node = self.child(key)
        value = node.content
        if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
            raise node._error("a finite number", value)
        return float(value)

    def unit(self, expected: str) -> None:
        unit = self.text("unit")
        if unit != expected:
            raise CalibrationFileError(
                f"`{self.path}` has the unit {unit!r}, expected {expected!r}: "
                "convert the value, or recalibrate"
            )

    def quantity(self, unit: str) -> float:
        self.unit(unit)
        return self.number("value")

    def pair(self, key: str) -> tuple[float, float]:
        low, high = self.array(key, (2,))
        return float(low), float(high)

    def array(self, key: str, shape: Sequence[int | None]) -> FloatArray:
        node = self.child(key)
        try:
            values = np.array(node.content, np.float64)
        except (TypeError, ValueError) as error:
            raise node._error("numbers", node.content) from error
        if values.size == 0 and shape[0] in (None, 0):
            values = np.zeros([n or 0 for n in shape])
        if values.ndim != len(shape) or any(
            n is not None and n != m for n, m in zip(shape, values.shape, strict=False)
        ):
            wanted = " x ".join("n" if n is None else str(n) for n in shape)
            raise node._error(f"{wanted} numbers", f"shape {values.shape}")
        if not np.isfinite(values).all():
            raise node._error("finite numbers", node.content)
        values.flags.writeable = False
        return values

    def _error(self, expected: str, seen: object) -> CalibrationFileError:
        shown = repr(seen)
        shown = shown if len(shown) <= 60 else shown[:57] + "..."
        where = f"`{self.path}`" if self.path else "the document"
        return CalibrationFileError(f"{where} must be {expected}, found {shown}")
