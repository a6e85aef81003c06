"""A history, boiled down: one unit's attempts, or the state of the whole line."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict
from datetime import UTC, datetime
from typing import Any

import numpy as np

from calib.types import FloatArray
from imu_cli.line.limits import Limits
from imu_cli.line.statistics import capability, drifts, outliers
from imu_cli.line.store import Run

FINISHED = ("PASS", "FAIL")


def unit_record(run: Run) -> dict[str, Any]:
    """Return one attempt as a plain document."""
    return {
        "id": run.id,
        "serial_number": run.serial_number,
        "attempt": run.attempt,
        "station": run.station,
        "fixture": run.fixture,
        "operator": run.operator,
        "tool_version": run.tool_version,
        "started": _utc(run.started).isoformat(),
        "ended": _utc(run.ended).isoformat() if run.ended else None,
        "outcome": run.outcome,
        "reason": run.reason,
        "parameters": {
            row.name: {
                "value": row.value,
                "standard_error": row.standard_error,
                "unit": row.unit,
            }
            for row in run.parameters
        },
        "checks": [
            {
                "name": row.name,
                "value": row.value,
                "low": row.low,
                "high": row.high,
                "unit": row.unit,
                "passed": row.passed,
                "action": row.action,
            }
            for row in sorted(run.checks, key=lambda row: row.position)
        ],
        "findings": [
            {"effect": row.effect, "p_value": row.p_value, "action": row.action}
            for row in sorted(run.findings, key=lambda row: row.position)
        ],
        "artefacts": {row.name: {"path": row.path, "sha256": row.sha256} for row in run.artefacts},
    }


def summarise(runs: list[Run], limits: Limits) -> dict[str, Any]:
    """Return yield, capability per parameter, outliers and drifts, as a plain document.

    Every unit counts once, by its last attempt that ended in PASS or FAIL.
    """
    last = {run.serial_number: run for run in runs if run.outcome in FINISHED}
    units = list(last.values())
    first = [run for run in runs if run.attempt == 1 and run.outcome in FINISHED]
    values = _columns(units)
    drifting = []
    for station in sorted({run.station for run in units}):
        mine = [run for run in units if run.station == station]
        days = np.array([_utc(run.started).timestamp() / 86400 for run in mine])
        drifting += drifts(station, days - days[0], _columns(mine))
    return {
        "format": "imu-cal/history",
        "version": 1,
        "runs": len(runs),
        "outcomes": {
            name: sum(run.outcome == name for run in runs)
            for name in ("PASS", "FAIL", "ERROR", "ABORTED", "RUNNING")
        },
        "units": len(units),
        "yield": _share(units),
        "first_pass_yield": _share(first),
        "capability": [asdict(item) for item in _capabilities(units, limits)],
        "outliers": [asdict(item) for item in outliers([u.serial_number for u in units], values)],
        "drifts": [asdict(item) for item in drifting],
    }


def _share(runs: list[Run]) -> float | None:
    return sum(run.outcome == "PASS" for run in runs) / len(runs) if runs else None


def _columns(units: list[Run]) -> dict[str, FloatArray]:
    """Return the parameters that every unit has, each as an array over units."""
    tables = [{row.name: row.value for row in run.parameters} for run in units]
    if not tables:
        return {}
    common = [name for name in tables[0] if all(name in table for table in tables)]
    return {name: np.array([table[name] for table in tables]) for name in common}


def _capabilities(units: list[Run], limits: Limits) -> Iterable[Any]:
    values: dict[str, list[float]] = {}
    unit_of: dict[str, str] = {}
    for run in units:
        for row in run.parameters:
            values.setdefault(row.name, []).append(row.value)
            unit_of[row.name] = row.unit
    for name, column in values.items():
        low = high = None
        for limit in limits.parameters:
            if limit.covers(name):
                low, high = limit.bounds(unit_of[name])
        yield capability(name, np.array(column), unit=unit_of[name], low=low, high=high)


def _utc(moment: datetime) -> datetime:
    """Give a moment its time zone back, which SQLite does not keep."""
    return moment if moment.tzinfo else moment.replace(tzinfo=UTC)
