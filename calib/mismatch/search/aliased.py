"""Turns that a recording samples too slowly to tell anything of.

Hands tremble 8 to 12 times a second. Sampled ten times a second, that is a slow rate which nobody
has turned with: turns do not close by degrees, and what they err by looks like whatever one likes.
"""

from __future__ import annotations

import numpy as np

from calib.mismatch.noise.noise import expected_levels, find_levels
from calib.mismatch.rows.rows import Kind, Rows
from calib.mismatch.search.jolted import means

TELLS = 0.02
"""rad by which most turns do not close from which on they tell nothing: of a quarter turn that is
more than a gyroscope's scale factor errs by before anybody calibrates it."""

FASTER = (
    "faster samples: at {rate:.3g} Hz what a trembling hand does to its turns looks like anything "
    "else, and they are left out (30 Hz will do, and so do turns in a fixture)"
)
"""What is missing then."""


def tells_nothing(rows: Rows) -> bool:
    """Return whether turns do not close by so much that they tell of nothing.

    Nor do they beside a gyroscope that is askew, or late.
    """
    turned = rows.kind[: rows.n_dense] == Kind.ATTITUDE
    if not turned.any():
        return False
    levels = (find_levels(rows, mean, expected_levels(rows)).values for mean in means(rows))
    return all(np.median(rows.variance(each)[turned]) > TELLS**2 for each in levels)
