"""Axes that are sampled one after another, whatever the delay between the two triads is.

A skew is that of axes to the x axis of their triad. How late one triad is beside the other has a
name of its own, and if it is too little to be found it is in the skew of one triad: four delays do
nearly what five do. So it is fitted with them, and what is known of each is what is left then.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from calib.calibration import Quantity
from calib.effects import get_effect
from calib.mismatch.hypotheses.families import effect_columns
from calib.mismatch.rows.rows import Rows
from calib.mismatch.search.accepted import Accepted
from calib.recording import TRIADS

SKEW, DELAY = "inter_axis_skew", "time_offset"


SURE = 3.0
"""Standard errors that tell a delay from none, or two from each other."""


def firsts_late(slug: str, parameters: Mapping[str, Quantity]) -> dict[str, str]:
    """Return the x axes, from which a skew counts, that may be late themselves, and what to say.

    Where y and z are off by the same it may be x, which has a filter of its own.
    """
    words = {}
    for triad in TRIADS:
        y, z = (parameters.get(f"{triad}_{axis}") for axis in "yz")
        if slug != SKEW or y is None or z is None or not (y.sigma and z.sigma):
            continue
        there = min(abs(q.value) / q.sigma for q in (y, z) if q.sigma)
        apart = abs(y.value - z.value) / float(np.hypot(y.sigma, z.sigma))
        if there > SURE > apart:
            way = "late" if y.value < 0 else "early"
            words[f"{triad}.x"] = (
                f"The y and z axes of the {TRIADS[triad]} differ from x by the same: it may be x "
                f"alone that is {way}."
            )
    return words


def with_delay(rows: Rows, accepted: Sequence[Accepted]) -> Rows:
    """Return rows of a recording by itself, with its delay fitted beside a skew of both triads."""
    skews = [a.candidate.channels for a in accepted if a.candidate.name == SKEW]
    both = any({c.split(".")[0] for c in channels} == set(TRIADS) for channels in skews)
    if not both or any(a.candidate.name == DELAY for a in accepted):
        return rows
    columns = list(effect_columns(get_effect(DELAY), rows, {}, reference=False).values())
    if not columns:
        return rows
    nuisance = np.column_stack((rows.nuisance, *columns))
    prior = rows.prior
    if len(prior):
        prior = np.vstack((prior, np.tile([0.0, np.inf], (len(columns), 1))))
    return replace(rows, nuisance=nuisance, prior=prior)
