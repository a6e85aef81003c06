"""Limits of a production line: what fails a unit, what only warns, what is allowed.

A station file names them by parameter, by group, by residual or by finding::

    [limits]
    "accel.bias" = { max_abs = "80 mg" }                    # all three axes
    "gyro.scale_factor_error.z" = { min = "-3 %", max = "3 %", action = "warn" }
    "accel.residual_rms" = { max = "5 mg" }

    [findings]
    default = "warn"                  # any effect that is not named below
    gyro_misalignment = "allow"
    accel_bias_step = "fail"
    unexplained = "fail"
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from calib.effects import effects
from imu_cli.line.quantity import parse_quantity, split_quantity

Action = Literal["fail", "warn", "allow"]
ACTIONS = ("fail", "warn", "allow")


@dataclass(frozen=True)
class Measured:
    """One number of a calibrated unit, in SI; the standard error is None where there is none."""

    name: str
    value: float
    standard_error: float | None
    unit: str


@dataclass(frozen=True)
class Limit:
    """A range for one parameter or a group of them; bounds are in the parameter's SI unit."""

    name: str
    low: str | None
    high: str | None
    max_abs: str | None
    action: Action

    def covers(self, name: str) -> bool:
        """Tell whether `name` is this parameter or of this group (``accel.bias`` has ``.x``)."""
        return name == self.name or name.startswith(self.name + ".")

    def bounds(self, unit: str) -> tuple[float | None, float | None]:
        """Return the lower and upper bound in SI; ValueError if a unit does not fit."""
        if self.max_abs is not None:
            bound = parse_quantity(self.max_abs, unit=unit)
            return -bound, bound
        low = None if self.low is None else parse_quantity(self.low, unit=unit)
        high = None if self.high is None else parse_quantity(self.high, unit=unit)
        return low, high


@dataclass(frozen=True)
class Check:
    """One limit held against one number or finding."""

    name: str
    value: float | None
    unit: str
    low: float | None
    high: float | None
    passed: bool
    action: Action

    @property
    def failed(self) -> bool:
        """True if this check fails the unit."""
        return not self.passed and self.action == "fail"


@dataclass(frozen=True)
class Limits:
    """All limits of a station."""

    parameters: tuple[Limit, ...]
    findings: Mapping[str, Action]
    default_finding: Action

    @classmethod
    def from_tables(cls, limits: Mapping[str, Any], findings: Mapping[str, Any]) -> Limits:
        """Read the tables ``[limits]`` and ``[findings]``; ValueError names what is wrong."""
        parsed = []
        for name, entry in limits.items():
            if not isinstance(entry, Mapping):
                raise ValueError(f"limit {name!r} must be a table such as {{ max_abs = '80 mg' }}")
            unknown = set(entry) - {"min", "max", "max_abs", "action"}
            if unknown:
                raise ValueError(
                    f"limit {name!r} has the unknown key {sorted(unknown)[0]!r}; "
                    "known: min, max, max_abs, action"
                )
            if not set(entry) & {"min", "max", "max_abs"}:
                raise ValueError(f"limit {name!r} sets no bound; give min, max or max_abs")
            if "max_abs" in entry and ("min" in entry or "max" in entry):
                raise ValueError(f"limit {name!r}: max_abs stands alone, without min or max")
            for key in ("min", "max", "max_abs"):
                if not isinstance(entry.get(key, ""), str):
                    raise ValueError(
                        f"limit {name!r}: write {entry[key]!r} with its unit, in quotes"
                    )
                if key in entry:
                    split_quantity(entry[key])
            action = _action(entry.get("action", "fail"), name)
            parsed.append(
                Limit(name, entry.get("min"), entry.get("max"), entry.get("max_abs"), action)
            )
        for name in findings:
            _check_finding(name)
        actions = {name: _action(value, name) for name, value in findings.items()}
        default = actions.pop("default", "warn")
        return cls(tuple(parsed), actions, default)

    def check(self, measured: list[Measured], found: list[str]) -> list[Check]:
        """Hold every limit against the unit's numbers, and every finding against its action.

        A limit that covers no number at all fails: a typing error must not pass every unit.
        """
        checks = []
        for limit in self.parameters:
            covered = [item for item in measured if limit.covers(item.name)]
            if not covered:
                checks.append(Check(limit.name, None, "", None, None, False, limit.action))
            for item in covered:
                low, high = limit.bounds(item.unit)
                inside = (low is None or item.value >= low) and (high is None or item.value <= high)
                checks.append(
                    Check(item.name, item.value, item.unit, low, high, inside, limit.action)
                )
        for name in found:
            action = self.findings.get(name, self.default_finding)
            checks.append(Check(f"finding.{name}", None, "", None, None, action == "allow", action))
        return checks


def _check_finding(name: str) -> None:
    """Refuse what no diagnosis finds: a typing error must not pass every unit."""
    known = [*effects(), "unexplained", "default"]
    if name not in known:
        near = difflib.get_close_matches(name, known, n=1)
        hint = f": did you mean {near[0]}?" if near else f"; known: {', '.join(known)}"
        raise ValueError(f"[findings] {name!r} is no effect{hint}")


def _action(value: Any, name: str) -> Action:
    if value not in ACTIONS:
        raise ValueError(f"{name!r}: action must be one of {', '.join(ACTIONS)}, got {value!r}")
    return value  # type: ignore[no-any-return]
