"""Devices that print text lines: their user says in a TOML template how they are commanded.

::

    [units]
    accel = "m/s^2"            # or g, mg
    gyro = "rad/s"             # or deg/s
    sign = -1                  # output = measured + sign * value
    decimals = 5

    [read]
    command = "get bias"
    reply = "bias {ax} {ay} {az} {gx} {gy} {gz}"

    [write]
    command = "set bias {ax} {ay} {az} {gx} {gy} {gz}"
    reply = "ok"               # optional

    [persist]                  # optional
    command = "save"
    reply = "saved"
"""

from __future__ import annotations

import re
import time
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calib.calibration import Calibration
from calib.errors import DriverTimeoutError, RecordingFormatError
from calib.gravity import STANDARD_GRAVITY as G
from drivers.flash.stream import StreamTarget
from drivers.flash.target import Action, Native, Plan, Row, determined_bias, not_held
from drivers.stream import StreamDriver

NAMES = ("ax", "ay", "az", "gx", "gy", "gz")
PARAMETERS = [f"{triad}.bias.{axis}" for triad in ("accel", "gyro") for axis in "xyz"]
FACTORS = {
    "accel": {"m/s^2": 1.0, "g": G, "mg": G / 1000},
    "gyro": {"rad/s": 1.0, "deg/s": np.pi / 180},
}
NUMBER = r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)"
ANSWER = 2.0


@dataclass(frozen=True)
class Exchange:
    """A command and the reply that it must have ('' if none)."""

    command: str
    reply: str


@dataclass(frozen=True)
class Template:
    """How a text device is commanded."""

    read: Exchange
    write: Exchange
    persist: Exchange | None
    accel_unit: str
    gyro_unit: str
    sign: int
    decimals: int

    @property
    def held(self) -> tuple[str, ...]:
        """Those of ax to gz that the device holds, in the order in which it tells them."""
        found = re.findall(r"\{(\w+)\}", self.read.reply)
        return tuple(found)


def load_template(path: Path) -> Template:
    """Read a template.

    Raises
    ------
    RecordingFormatError
        If it is missing, no TOML, or lacks something; the message names it.
    """
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise RecordingFormatError(f"{path}: cannot read the template: {error}") from error

    def wrong(what: str) -> RecordingFormatError:
        return RecordingFormatError(f"{path}: {what}")

    def exchange(section: str) -> Exchange:
        table = document.get(section)
        if not isinstance(table, dict) or not isinstance(table.get("command"), str):
            raise wrong(f"[{section}] needs a command")
        return Exchange(table["command"], str(table.get("reply", "")))

    units: Mapping[str, Any] = document.get("units", {})
    for triad, factors in FACTORS.items():
        if units.get(triad) not in factors:
            raise wrong(f"[units] {triad} must be one of {', '.join(factors)}")
    if units.get("sign") not in (1, -1):
        raise wrong("[units] sign must be 1 (the device adds) or -1 (it subtracts)")
    decimals = units.get("decimals")
    if not isinstance(decimals, int) or not 0 <= decimals <= 12:
        raise wrong("[units] decimals must be a whole number from 0 to 12")
    template = Template(
        exchange("read"),
        exchange("write"),
        exchange("persist") if "persist" in document else None,
        units["accel"],
        units["gyro"],
        units["sign"],
        decimals,
    )
    held, written = template.held, re.findall(r"\{(\w+)\}", template.write.command)
    if not held or sorted(held) != sorted(set(written)) or not set(held) <= set(NAMES):
        raise wrong(
            "[read] reply and [write] command must hold the same of {ax}, {ay}, {az}, {gx}, {gy}, "
            "{gz}"
        )
    return template


class TextTarget(StreamTarget):
    """The biases of a device that takes lines of text."""

    name = "biases"
    volatile = True

    def __init__(self, driver: StreamDriver, template: Template) -> None:
        super().__init__(driver)
        self._template = template
        self.can_persist = template.persist is not None
        self._heard = ""

    def open(self) -> None:
        self._driver.tap = self._hear
        super().open()

    def _hear(self, data: bytes, arrival: float | None) -> None:
        self._heard = (self._heard + data.decode("ascii", "replace"))[-65536:]

    def read(self) -> Native:
        template = self._template
        pattern = re.escape(template.read.reply)
        for name in template.held:
            pattern = pattern.replace(re.escape(f"{{{name}}}"), NUMBER, 1)
        match = self._ask(template.read.command, pattern)
        values = map(float, match.groups())
        return dict(zip(template.held, values, strict=True))

    def write(self, values: Mapping[str, float]) -> None:
        template = self._template
        words = {name: f"{value:.{template.decimals}f}" for name, value in values.items()}
        command = template.write.command.format(**words)
        self._ask(command, re.escape(template.write.reply))

    def plan(self, old: Native, calibration: Calibration) -> Plan:
        template = self._template
        bias = np.concatenate([determined_bias(calibration, t) for t in ("accel", "gyro")])
        new, rows, shift = Native(), [], np.zeros(6)
        for name in template.held:
            k = NAMES.index(name)
            triad, unit = ("accel", template.accel_unit) if k < 3 else ("gyro", template.gyro_unit)
            factor = FACTORS[triad][unit]
            wanted = old[name] - template.sign * float(np.nan_to_num(bias[k])) / factor
            new[name] = old[name] if np.isnan(bias[k]) else round(wanted, template.decimals) + 0.0
            shift[k] = template.sign * (new[name] - old[name]) * factor
            rows.append(Row(name, PARAMETERS[k], old[name], new[name], wanted, unit))
        whole = {
            triad + ".bias"
            for triad, letters in (("accel", NAMES[:3]), ("gyro", NAMES[3:]))
            if set(letters) <= set(template.held)
        }
        return Plan(
            tuple(rows),
            new,
            Action(shift=shift[:3]),
            Action(shift=shift[3:]),
            not_held(calibration, whole),
        )

    def persist(self) -> None:
        exchange = self._template.persist
        assert exchange is not None
        self._ask(exchange.command, re.escape(exchange.reply))

    def restart(self) -> None:
        """Connect again: how to restart it only its user knows."""
        self._reconnect()

    def snippet(self, values: Mapping[str, float]) -> str:
        template = self._template
        words = {name: f"{value:.{template.decimals}f}" for name, value in values.items()}
        command = template.write.command.format(**words)
        return f"# Send this line after every power-on.\n{command}\n"

    def _ask(self, command: str, pattern: str) -> re.Match[str]:
        """Send a line; wait for a line that holds `pattern`."""
        self._heard = ""
        self._driver.send(command.encode("ascii") + b"\n")
        line = re.compile(rf"(?m)^[ \t]*{pattern}[ \t]*\r?$")
        deadline = time.monotonic() + ANSWER
        while time.monotonic() < deadline:
            self._driver.read(0.05)
            match = line.search(self._heard) if pattern else re.match("", "")
            if match is not None:
                return match
        raise DriverTimeoutError(
            f"{self.address}: {command!r} was not answered as its template says in {ANSWER:g} s"
        )
