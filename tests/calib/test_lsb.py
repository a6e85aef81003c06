"""Counts of a converter, and bits of them that never change."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.audit import audit
from calib.faults import resolution
from calib.lsb import between_counts, find_stuck_bits, refined
from calib.model import SensorModel
from calib.recording import Recording
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import CONSUMER

LSB = np.repeat([9.80665 / 8192, np.radians(1.0) / 32.8], 3)


def simulated(seed: int) -> Recording:
    rng = np.random.default_rng(seed)
    return simulate(bench_protocol(rng, poses=20), SensorModel(), CONSUMER, rng=rng, rate=100.0)


def counts_of(recording: Recording) -> np.ndarray:
    return np.rint(np.hstack((recording.accel, recording.gyro)) / LSB).astype(np.int64)


def read_as(recording: Recording, counts: np.ndarray) -> Recording:
    values = counts * LSB
    return replace(recording, accel=values[:, :3], gyro=values[:, 3:])


@pytest.mark.parametrize("decimals", [None, 5])
def test_all_bits_of_a_sensor_that_turns_change(decimals: int | None) -> None:
    for seed in range(4):
        values = counts_of(simulated(seed)) * LSB
        if decimals is not None:
            values = np.round(values, decimals)
        assert find_stuck_bits(values, resolution(values)) == []


@settings(deadline=None, max_examples=40)
@given(
    channel=st.integers(0, 5),
    bit=st.integers(1, 6),
    high=st.booleans(),
    offset=st.floats(-20.0, 20.0),
)
def test_a_bit_that_never_changes_is_found_wherever_zero_is(
    channel: int, bit: int, high: bool, offset: float
) -> None:
    counts = counts_of(simulated(1))
    counts[:, channel] = (
        counts[:, channel] | (1 << bit) if high else counts[:, channel] & ~(1 << bit)
    )
    values = counts * LSB + offset
    ((c, size),) = find_stuck_bits(values, resolution(values))
    assert c == channel
    assert size == pytest.approx((1 << bit) * LSB[channel], rel=1e-3)


def test_the_audit_says_how_large_a_stuck_bit_is() -> None:
    real = simulated(1)
    counts = counts_of(real)
    counts[:, 4] |= 1 << 5
    (found,) = [f for f in audit(read_as(real, counts)).findings if f.kind == "bit"]
    assert found.channels == ("gyro.y",)
    assert f"{32 * LSB[4]:.3g} rad/s" in found.message


def test_the_size_of_a_count_is_that_of_many() -> None:
    rng = np.random.default_rng(5)
    counts = np.cumsum(rng.integers(-900, 900, (4000, 1)), axis=0)
    values = np.round(counts * 0.0024, 4)
    size = refined(np.abs(np.diff(values, axis=0)), np.array([0.0025]))
    assert size[0] == pytest.approx(0.0024, rel=1e-5)


def test_constant_channels_and_values_that_are_no_counts_have_no_bits() -> None:
    rng = np.random.default_rng(5)
    values = np.column_stack((np.zeros(2000), rng.normal(size=2000)))
    assert find_stuck_bits(values, resolution(values)) == []


@pytest.mark.parametrize("share", [0.2, 0.5])
@pytest.mark.parametrize("lsb", [0.0, 0.3, 1.0, 1.5])
def test_quantiles_between_counts_are_those_of_what_was_rounded(share, lsb):
    noise = np.random.default_rng(2).normal(0.0, 1.0, (20_000, 1))
    seen = noise if lsb == 0 else np.rint(noise / lsb + 0.3) * lsb
    change = np.abs(np.diff(seen, n=2, axis=0))
    # A count has a twelfth of its square for variance.
    size = np.sqrt(6.0 * (1.0 + lsb**2 / 12.0)) * {0.2: 0.2533, 0.5: 0.6745}[share]
    assert between_counts(change, np.array([lsb]), share)[0] == pytest.approx(size, rel=0.06)


def test_of_counts_that_never_change_a_quantile_is_within_half_of_one():
    still = np.zeros((100, 2))
    assert between_counts(still, np.array([2.0, 0.0]), 0.5) == pytest.approx([0.5, 0.0])
