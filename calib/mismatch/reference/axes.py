"""Whether an accelerometer has other axes than the simulation that it is compared with.

Its three angles of non-orthogonality are those of a frame of its own: x along its x axis, y in the
plane of its x and y. A simulation's frame may be another (y axis, and the plane of y and z; or the
body's), and its gyroscope's may be that. Then the accelerometer is turned against it as well.
"""

from __future__ import annotations

import numpy as np

from calib.effects import get_effect
from calib.mismatch.noise.noise import expected_levels, make_whitener
from calib.mismatch.reference.setup import ACCEL_ANGLES
from calib.mismatch.rows.rows import Rows
from calib.mismatch.search.accepted import contrast_noise, fitted
from calib.mismatch.search.refine import likelihood_gain
from calib.mismatch.twin.twin import baseline_column

CLEARLY = 10.0
"""Log-likelihood that turning the accelerometer gains at least, and turning both triads does not:
what is concealed from a simulation in the sensor's own frame gains less by it."""


def has_own_axes(rows: Rows) -> bool:
    """Return whether rows beside a simulation show an accelerometer that is turned, and it alone.

    Both triads are where the sensor is mounted at an angle: that is a finding.
    """
    mean = fitted(rows, [])
    whitener = make_whitener(rows, expected_levels(rows), contrast_noise(rows, []), mean)
    y = whitener.project(rows.residual)
    alone = [baseline_column(name, rows.state) for name in ACCEL_ANGLES]
    both = get_effect("reference_misalignment").columns(rows.state, {}).values()
    gains = [
        likelihood_gain(whitener.project(np.stack([rows.column(c) for c in each], axis=1)), y)
        for each in (alone, both)
    ]
    return gains[0] - max(gains[1], 0.0) > CLEARLY
