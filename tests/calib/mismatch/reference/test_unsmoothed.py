"""What a captured motion lost, found however noisy the capture is."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from calib.effects import get_effect
from calib.effects.base import State
from calib.mismatch.reference.unsmoothed import SLUG, smoothing
from calib.recording import CHANNELS
from calib.rotation import integrate_rate, mat_from_quat

STEP, GRAVITY = 0.01, 9.80665


def moved(seed: int = 1, n: int = 6000) -> State:
    """Return a body that is waved, at up to 5 Hz."""
    rng = np.random.default_rng(seed)
    time = STEP * np.arange(n)
    rate, away = (gaussian_filter1d(rng.normal(size=(n, 3)), 3.0, axis=0) for _ in range(2))
    rate *= 2.0 / rate.std()
    mat = mat_from_quat(integrate_rate(time, rate))
    room = 3.0 * away / away.std() + np.array([0.0, 0.0, GRAVITY])
    force = np.einsum("nji,nj->ni", mat, room)
    return State(time=time, force=force, rate=rate, mat_ns=mat, gravity=GRAVITY)


def lost(state: State, sizes: dict[str, float]) -> np.ndarray:
    """Return what smoothing of these sizes leaves of recording minus model, (n, 6)."""
    out = np.zeros((len(state.time), len(CHANNELS)))
    for channel, values in get_effect(SLUG).contribution(state, sizes).items():
        out[:, CHANNELS.index(channel)] = values
    return out


@pytest.mark.parametrize(
    "sizes",
    [
        {"orientation": 1e-4, "position": 1e-4},
        {"orientation_fourth": 1.6e-7, "position_fourth": 1.6e-7},
        {"position": 2e-4},
        {"orientation_fourth": 5e-7},
        {},
    ],
)
def test_sizes_are_found_in_noise_that_columns_have_as_well(sizes: dict[str, float]) -> None:
    true, rng = moved(), np.random.default_rng(2)
    left = lost(true, sizes)
    # What the sensor has besides is no smoothing: gains, an arm, white noise.
    left[:, 3:] += 0.01 * true.rate
    left[:, :3] += 0.02 * true.gradient[:, :, 1] + rng.normal(0.0, 0.02, true.force.shape)
    left[:, 3:] += rng.normal(0.0, 1e-3, true.rate.shape)
    # And the capture errs: as much as it does so, the differences do, the other way round.
    shake, jolt = (gaussian_filter1d(rng.normal(size=(6000, 3)), 2.0, axis=0) for _ in range(2))
    shake, jolt = 0.1 * shake, 0.2 * jolt
    seen = replace(true, rate=true.rate + shake, force=true.force + jolt)
    found = smoothing(seen, left - np.hstack((jolt, shake)))
    for name, size in sizes.items():
        assert found[name] == pytest.approx(size, rel=0.15)
    # Whatever else is found takes next to nothing.
    more = {name: size for name, size in found.items() if name not in sizes}
    assert lost(true, more).std() < 0.1 * max(lost(true, sizes).std(), 0.05)


def test_nothing_is_missing_of_what_does_not_move() -> None:
    n = 500
    still = State(
        time=STEP * np.arange(n),
        force=np.tile([0.0, 0.0, GRAVITY], (n, 1)),
        rate=np.zeros((n, 3)),
        mat_ns=np.tile(np.eye(3), (n, 1, 1)),
        gravity=GRAVITY,
    )
    assert smoothing(still, np.zeros((n, 6))) == {}


def test_what_chance_makes_is_none() -> None:
    true, rng = moved(), np.random.default_rng(4)
    found = [smoothing(true, rng.normal(0.0, 0.02, (6000, 6))) for _ in range(10)]
    assert found == [{}] * 10
