"""A `Calibration` as a JSON document, and back: ``imu-cal/calibration`` version 1.

Every number stands beside its unit. The published schema is ``schemas/calibration.schema.json``.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from importlib import resources
from typing import Any

import numpy as np

from calib.calibration import (
    VERSION,
    Calibration,
    Gravity,
    TemperatureRange,
    parameter_unit,
)
from calib.document_parts import (
    read_event,
    read_housing,
    read_noise,
    read_poses,
    read_provenance,
    read_summary,
    write_device,
    write_housing,
    write_noise,
    write_poses,
    write_summary,
)
from calib.effects import effects
from calib.effects.base import Term
from calib.errors import CalibrationFileError
from calib.json_node import Node
from calib.model import SensorModel, Triad
from calib.plausible import check_plausible
from calib.types import FloatArray

FORMAT = "imu-cal/calibration"
EQUATION = "measured = (I + S + M) @ true + bias + further terms + noise"
BASELINE = tuple(Triad().parameters("accel") | Triad().parameters("gyro"))

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
        "accel": write_summary(calibration.accel),
        "gyro": write_summary(calibration.gyro),
        "noise": write_noise(calibration.noise),
        "poses": write_poses(calibration.poses),
        "housing": write_housing(calibration.housing),
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
            "device": write_device(provenance.device),
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
        expected, contradicts itself, or is of no sensor on Earth; the message names the key.
    """
    node = Node(document, "")
    if node.get("format") != FORMAT:
        raise CalibrationFileError(
            f"not a calibration: `format` is {node.get('format')!r}, expected {FORMAT!r}; "
            "give a file that `imu-cal calibrate` wrote"
        )
    version = _check_version(node.text("version"))
    try:
        calibration = _read(node, version)
    except CalibrationFileError:
        raise
    except ValueError as error:  # what the classes check when they are made
        raise CalibrationFileError(f"the calibration contradicts itself: {error}") from error
    check_plausible(calibration)
    return calibration


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


def _read(node: Node, version: str) -> Calibration:
    values: dict[str, float] = {}
    sigmas: dict[str, float] = {}
    undetermined: list[str] = []
    parameters = node.child("parameters")
    for name in BASELINE:
        _read_parameter(parameters.child(name), name, values, sigmas, undetermined)
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
            own[name] = _read_parameter(content.child(name), full, values, sigmas, undetermined)
        terms.append(Term(slug, own))
    reference = node.child("reference_temperature").quantity("°C")
    triads = {
        triad: Triad().with_parameters(
            {n: v for n, v in values.items() if n.startswith(f"{triad}.")}
        )
        for triad in ("accel", "gyro")
    }
    names, covariance = _with_alone(*_read_covariance(node.child("covariance")), sigmas)
    gravity = node.child("gravity")
    temperature = node.optional("temperature_range")
    if temperature is not None:
        temperature.unit("°C")
    return Calibration(
        SensorModel(triads["accel"], triads["gyro"], tuple(terms), reference),
        names,
        covariance,
        tuple(undetermined),
        Gravity(gravity.quantity("m/s²"), gravity.text("source"), gravity.least("sigma", 0.0)),
        accel=read_summary(node.optional("accel")),
        gyro=read_summary(node.optional("gyro")),
        temperature=None
        if temperature is None
        else TemperatureRange(temperature.number("low"), temperature.number("high")),
        noise=read_noise(node.optional("noise")),
        poses=read_poses(node.optional("poses")),
        housing=read_housing(node.optional("housing")),
        events=tuple(read_event(item) for item in node.items("events")),
        provenance=read_provenance(node.child("provenance")),
        version=version,
        extra={k: v for k, v in node.mapping().items() if k not in _KEYS},
    )


def _read_parameter(
    node: Node,
    name: str,
    values: dict[str, float],
    sigmas: dict[str, float],
    undetermined: list[str],
) -> float:
    try:
        unit = parameter_unit(name)
    except ValueError as error:
        raise CalibrationFileError(f"{node.path}: {error}") from error
    values[name] = node.quantity(unit)
    if node.get("status") == "undetermined":
        undetermined.append(name)
    elif node.get("sigma") is not None:
        sigmas[name] = node.least("sigma", 0.0)
    return values[name]


def _with_alone(
    names: tuple[str, ...], covariance: FloatArray, sigmas: Mapping[str, float]
) -> tuple[tuple[str, ...], FloatArray]:
    """Return the covariance with what has a standard error, but was typed in without a row there.

    How it goes with others nobody said.
    """
    alone = [name for name in sigmas if name not in names]
    both = np.diag([0.0] * len(names) + [sigmas[name] ** 2 for name in alone])
    both[: len(names), : len(names)] = covariance
    return (*names, *alone), both


def _read_covariance(node: Node) -> tuple[tuple[str, ...], FloatArray]:
    names = node.texts("names")
    units = node.texts("units")
    try:
        expected = tuple(parameter_unit(name) for name in names)
    except ValueError as error:
        raise CalibrationFileError(f"{node.path}: {error}") from error
    if units != expected:
        raise CalibrationFileError(f"{node.path}: units are {units}, expected {expected}")
    return names, node.array("values", (len(names), len(names)))
