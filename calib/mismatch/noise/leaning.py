"""Whether a sensor leans at rest, where only changes within its rests can tell.

How far it is expected to lean grows with the square of time, so that in a rest of minutes it would
be more than any drift; and what it does to a rest's start, middle and end goes together, which
drift does not. Where drift is most of what contrasts hold, these have no say in the levels of the
noise (`contrast.telling`), and a lean would stay at what is expected of one. So both are compared
once, by the likelihood of all rows together: a lean as is expected of it, and next to none.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.mismatch.noise.contrast import contrast_variance, telling
from calib.mismatch.noise.noise import (
    bare_levels,
    level_penalty,
    make_whitener,
)
from calib.mismatch.noise.sensornoise import LEAN
from calib.mismatch.rows.rows import Rows
from calib.types import FloatArray

NONE = 1e-4
"""Of the variance that is expected of a lean: next to none of it."""

SPREAD = 1.0
"""Standard deviation of its logarithm then: what closures err by must not bring it back."""

SURE = float(np.log(20.0))
"""Log-likelihood by which next to none has to be ahead."""


def lean_share(rows: Rows) -> float:
    """Return what of the variance that is expected of a lean the rows allow: 1, or `NONE`."""
    known = rows.lean is not None and rows.lean.sway.expected > 0
    if known or all(c.group != LEAN for c in rows.components) or len(telling(rows)):
        return 1.0
    contrast, mean = contrast_variance(rows), np.hstack((rows.baseline, rows.nuisance))
    value = {share: _likelihood(leaning(rows, share), mean, contrast) for share in (1.0, NONE)}
    return NONE if value[NONE] > value[1.0] + SURE else 1.0


def leaning(rows: Rows, share: float) -> Rows:
    """Return rows of which a share of the variance is expected that is of a lean otherwise.

    The last are kept: what was found of them holds where they are asked for again.
    """
    if share == 1.0:
        return rows
    of, known, leant = rows.kept.get("leaning", (None, None, None))
    if of is not rows.residual or known != share:
        components = tuple(
            replace(c, expected=share * c.expected, spread=SPREAD) if c.group == LEAN else c
            for c in rows.components
        )
        leant = replace(rows, components=components)
        rows.kept["leaning"] = rows.residual, share, leant
    assert isinstance(leant, Rows)
    return leant


def _likelihood(rows: Rows, mean: FloatArray, contrast: FloatArray) -> float:
    """Return the log-likelihood of all rows at the likeliest levels, and of these."""
    levels = bare_levels(rows).values
    whitener = make_whitener(rows, levels, contrast, mean)
    y = whitener.project(rows.residual)
    return -0.5 * (float(y @ y) + whitener.log_det) - level_penalty(rows, levels)
