"""At rest what effects are functions of is still, though the truth has noise."""

import numpy as np

from calib.effects.base import State
from calib.mismatch.reference.stilled import stilled
from calib.rotation import mat_from_quat, quat_from_rotvec


def test_noise_of_orientations_moves_nothing_at_rest_and_stays_elsewhere():
    rng, n = np.random.default_rng(1), 400
    mat = mat_from_quat(quat_from_rotvec(rng.normal(0, 0.02, (n, 3))))
    force = mat[:, 2, :] * 9.8
    rate = rng.normal(0, 0.1, (n, 3))
    state = State(np.arange(n) / 100, force, rate, mat_ns=mat)
    still = stilled(state, np.array([[50, 350]]))
    for values in (still.force, still.rate, still.mat_ns, still.gradient):
        assert np.ptp(values[50:350], axis=0).max() < 1e-12
        assert (np.ptp(values[350:], axis=0) > 0).all()
    assert still.mat_ns is not None
    middle = still.mat_ns[200]
    assert np.allclose(middle @ middle.T, np.eye(3), atol=1e-12)
    assert np.abs(middle - np.eye(3)).max() < 6 * 0.02 / np.sqrt(300)


def test_a_rest_sets_in_as_softly_as_a_band_has_it():
    rng, n = np.random.default_rng(1), 400
    state = State(np.arange(n) / 100, rng.normal(size=(n, 3)), rng.normal(size=(n, 3)))
    soft = stilled(state, np.array([[100, 300]]), ramp=20)
    assert np.ptp(soft.force[120:280], axis=0).max() < 1e-12
    # Of what is left of the noise each sample has less than the one before.
    left = soft.force[100:120] - soft.force[200]
    share = left / (state.force[100:120] - soft.force[200])
    assert (np.diff(share, axis=0) < 0).all()
    assert (share < 1).all()
    assert (share > 0).all()
    assert np.array_equal(soft.force[:100], state.force[:100])
