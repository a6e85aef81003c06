"""Recordings without a clock: what nobody can tell of them, and what is told by the sample."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.calibration import Quantity
from calib.mismatch.findings.diagnosis import Finding
from calib.mismatch.rows.grid import UNCLOCKED
from calib.types import FloatArray

UNKNOWN_DRIFT = 4.0
"""Spread of the prior of drift where seconds are not known."""

CLOCKED = ("_warm_up", "_bias_step", "_settling")


def is_rate(slug: str) -> bool:
    """Whether an effect follows a rate of temperature."""
    return slug.endswith("_temperature_rate")


def by_sample(item: Finding, samples: int) -> Finding:
    """Return a finding that follows a rate in K per sample: of this recording, not of the sensor.

    Nobody knows how long a sample took, so that the term fits no other stream.
    """
    interval = UNCLOCKED / (samples - 1)
    values = {
        name: Quantity(
            q.value / interval,
            None if q.sigma is None else q.sigma / interval,
            q.unit.replace("K/s", "K/sample"),
        )
        for name, q in item.parameters.items()
    }
    note = "Its size is per sample, as the clock is invalid, and fits this recording alone."
    return replace(item, kind="event", parameters=values, sentence=f"{item.sentence} {note}")


def without_rates(
    names: tuple[str, ...], covariance: FloatArray
) -> tuple[tuple[str, ...], FloatArray]:
    """Return names and covariance without rates."""
    keep = [i for i, n in enumerate(names) if not is_rate(n.split(".")[0])]
    return tuple(names[i] for i in keep), covariance[np.ix_(keep, keep)]
