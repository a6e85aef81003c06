"""What a fit without a finding says, and which of it is determined."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.mismatch.noise.noise import expected_levels
from calib.mismatch.search.accepted import accept, contrast_noise, fitted
from calib.mismatch.search.proof import fit_without
from calib.mismatch.search.search import Outcome

SLUG = "gyro_scale_asymmetry"


def outcome(rows, stack) -> Outcome:
    """Return one finding, of 2e-3 on each axis, in rows that have it."""
    all_ = max((c for c in stack.physics.values() if c.name == SLUG), key=lambda c: len(c.index))
    own = accept(stack, all_, 100.0)
    made = rows.with_residual(rows.residual + own.columns @ (2e-3 / own.typical))
    levels, contrast = expected_levels(rows), contrast_noise(rows, [own])
    return Outcome(made, (own,), levels, contrast, 10.0, frozenset({SLUG}))


def test_what_priors_hold_moves_by_no_more_than_they_let_it(stacked):
    # Of an axis that hardly turned, the scale factor is what is expected of a part, with the
    # finding and without it.
    rows, stack = stacked
    found = outcome(rows, stack)
    left, without, determined = fit_without(found, 0)
    p = rows.baseline.shape[1]
    assert determined[:p].all()
    np.testing.assert_allclose(
        left, found.rows.residual - fitted(found.rows, []) @ without, atol=1e-12
    )
    still = rows.baseline.copy()
    which = rows.names.index("gyro.scale_factor_error.z")
    still[:, which] *= 1e-6
    hidden = replace(found, rows=replace(found.rows, baseline=still))
    _, held, _ = fit_without(hidden, 0)
    fit = hidden.fit(reference=False)
    assert abs(held[which] - fit.step[which]) < 0.01
