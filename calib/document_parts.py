"""The parts of a calibration document, each written and read; `calib.document` is the whole."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np

from calib.calibration import (
    Event,
    Housing,
    InputFile,
    Noise,
    PoseTable,
    Provenance,
    Quantity,
    TriadSummary,
)
from calib.errors import CalibrationFileError
from calib.fit import Exclusion
from calib.json_node import Node
from calib.recording import DeviceInfo

_DEVICE_UNITS = {
    "accel_full_scale": "m/s²",
    "gyro_full_scale": "rad/s",
    "accel_lsb": "m/s²",
    "gyro_lsb": "rad/s",
    "rate": "Hz",
}


def write_summary(summary: TriadSummary | None) -> dict[str, Any] | None:
    """Return how a triad was solved, as ``accel`` and ``gyro`` hold it."""
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


def read_summary(node: Node | None) -> TriadSummary | None:
    """Return how a triad was solved, from ``accel`` or ``gyro``."""
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
            Exclusion(item.pair("interval"), item.least("weight", 0.0), item.text("reason"))
            for item in node.items("excluded")
        ),
        node.texts("advice"),
    )


def write_noise(noise: Noise | None) -> dict[str, Any] | None:
    """Return the noise at rest, as ``noise`` holds it."""
    if noise is None:
        return None
    return {
        "rate": {"value": noise.rate, "unit": "Hz"},
        "accel": {"noise_density": noise.accel.tolist(), "unit": "m/s²/√Hz"},
        "gyro": {"noise_density": noise.gyro.tolist(), "unit": "rad/s/√Hz"},
    }


def read_noise(node: Node | None) -> Noise | None:
    """Return the noise at rest, from ``noise``."""
    if node is None:
        return None
    accel, gyro = node.child("accel"), node.child("gyro")
    accel.unit("m/s²/√Hz")
    gyro.unit("rad/s/√Hz")
    rate = node.child("rate").quantity("Hz")
    densities = [item.array("noise_density", (3,)) for item in (accel, gyro)]
    if rate <= 0 or min(values.min() for values in densities) < 0:
        raise CalibrationFileError(
            f"{node.path} has a rate of {rate:g} Hz and densities of {densities[0].tolist()} and "
            f"{densities[1].tolist()}, expected a rate above 0 and densities of 0 or more"
        )
    return Noise(rate, *densities)


def write_poses(poses: PoseTable | None) -> dict[str, Any] | None:
    """Return the mean of each pose, as ``poses`` holds them."""
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


def read_poses(node: Node | None) -> PoseTable | None:
    """Return the mean of each pose, from ``poses``."""
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


def write_housing(housing: Housing | None) -> dict[str, Any] | None:
    """Return the alignment to the housing, as ``housing`` holds it."""
    if housing is None:
        return None
    return {
        "mat_hs": {"values": housing.mat_hs.tolist(), "unit": "1"},
        "sigma": {"values": housing.sigma.tolist(), "unit": "rad"},
        "residual_rms": {"value": housing.residual_rms, "unit": "rad"},
        "poses": housing.poses,
    }


def read_housing(node: Node | None) -> Housing | None:
    """Return the alignment to the housing, from ``housing``."""
    if node is None:
        return None
    node.child("mat_hs").unit("1")
    node.child("sigma").unit("rad")
    mat_hs = node.child("mat_hs").array("values", (3, 3))
    if not np.allclose(mat_hs @ mat_hs.T, np.eye(3), atol=1e-9) or np.linalg.det(mat_hs) < 0:
        raise CalibrationFileError(f"{node.path}.mat_hs is no rotation matrix: {mat_hs.tolist()}")
    sigma = node.child("sigma").array("values", (3,))
    if sigma.min() < 0:
        raise CalibrationFileError(f"{node.path}.sigma must be 0 or more, found {sigma.tolist()}")
    return Housing(
        mat_hs,
        sigma,
        node.child("residual_rms").quantity("rad"),
        int(node.number("poses")),
    )


def read_event(node: Node) -> Event:
    """Return one of ``events``: an effect that a span of the recording had."""
    content = node.child("parameters")
    parameters = {}
    for name in content.mapping():
        item = content.child(name)
        sigma = None if item.get("sigma") is None else item.least("sigma", 0.0)
        parameters[name] = Quantity(item.number("value"), sigma, item.text("unit"))
    intervals = node.array("intervals", (None, 2))
    return Event(
        node.text("effect"),
        node.texts("channels"),
        tuple((float(a), float(b)) for a, b in intervals),
        parameters,
    )


def write_device(device: DeviceInfo) -> dict[str, Any]:
    """Return what is known of the sensor, with units, as ``provenance.device`` holds it."""
    out: dict[str, Any] = {}
    for item in fields(device):
        value = getattr(device, item.name)
        unit = _DEVICE_UNITS.get(item.name)
        out[item.name] = value if unit is None or value is None else {"value": value, "unit": unit}
    return out


def read_provenance(node: Node) -> Provenance:
    """Return where the calibration came from, from ``provenance``."""
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
