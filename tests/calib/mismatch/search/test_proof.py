"""What a fit without a finding determines."""

import numpy as np

from calib.mismatch.search.proof import _least_squares


def test_what_two_columns_share_is_not_determined():
    rng = np.random.default_rng(4)
    design = rng.normal(size=(20, 3))
    design = np.column_stack((design, design[:, 0] - 2.0 * design[:, 1]))
    y = design @ [1.0, 2.0, 3.0, 0.0]
    solution, determined = _least_squares(design, y)
    np.testing.assert_array_equal(determined, [False, False, True, False])
    np.testing.assert_allclose(solution, np.linalg.lstsq(design, y, rcond=1e-9)[0], atol=1e-12)
    assert _least_squares(design[:, :3], y)[1].all()
