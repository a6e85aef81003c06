"""Leave-one-out residuals."""

import numpy as np

from calib.crossvalidation import leave_one_out
from calib.model import Triad
from calib.poses import Poses
from calib.solvers import accel_solvers

GRAVITY = 9.80665


def test_a_pose_is_judged_by_the_others() -> None:
    rng = np.random.default_rng(1)
    true = Triad(np.array([0.1, -0.2, 0.3]), np.array([0.01, -0.02, 0.0]))
    direction = rng.standard_normal((25, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    accel = true.distort(GRAVITY * direction)
    exact = accel_solvers()["exact"]
    clean = leave_one_out(Poses.from_vectors(accel, sigma=1e-6), exact, gravity=GRAVITY)
    np.testing.assert_allclose(clean, 0, atol=1e-9)
    accel[7] += 0.1 * direction[7]
    found = leave_one_out(Poses.from_vectors(accel, sigma=1e-6), exact, gravity=GRAVITY)
    # The one that is off shows it whole: the fit without it knows nothing of it.
    assert abs(found[7] - 0.1) < 2e-3
