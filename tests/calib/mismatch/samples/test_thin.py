"""A long recording is thinned: nothing depends on its batches, and nothing that counts is lost."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.effects.base import Term
from calib.mismatch import Thinned, diagnose_recording, diagnose_thinned, thin
from calib.mismatch.rows.choice import MOST, choose_poses
from calib.mismatch.samples.thin import sections
from calib.recording import Recording
from calib.statics import RestFinder, find_poses

from ..bench import GRAVITY, recording


def batches(real: Recording, size: int) -> Iterator[Recording]:
    for at in range(0, len(real), size):
        yield real.slice(at, min(at + size, len(real)))


def thinned(real: Recording, size: int, *, section: int = 1024) -> Thinned:
    return thin(lambda: batches(real, size), whole=1500, section=section, resting=6144)


@pytest.fixture(scope="module")
def real() -> Recording:
    made = recording(Term("gyro_g_sensitivity", {"gxx": 5e-4, "gzy": -5e-4}))
    gyro = made.gyro.copy()
    gyro[3000:3004] = gyro[2999]
    return replace(made, gyro=gyro)


@pytest.fixture(scope="module")
def once(real: Recording) -> Thinned:
    return thinned(real, len(real))


def same(a: Recording, b: Recording) -> bool:
    return all(
        np.array_equal(getattr(a, name), getattr(b, name))
        for name in ("time", "accel", "gyro", "temperature", "lost")
    )


@settings(max_examples=25, deadline=None)
@given(size=st.integers(1, 6000))
@pytest.mark.long
def test_nothing_depends_on_the_batches(real: Recording, once: Thinned, size: int) -> None:
    again = thinned(real, size)
    assert same(once.recording, again.recording)
    assert (once.samples, once.duration, once.found) == (len(real), real.duration, again.found)
    np.testing.assert_array_equal(once.poses.start, again.poses.start)
    np.testing.assert_array_equal(once.poses.accel_covariance, again.poses.accel_covariance)
    np.testing.assert_array_equal(once.seen.spoilt, again.seen.spoilt)
    assert once.seen.findings == again.seen.findings


@pytest.mark.long
def test_the_diagnosis_is_the_same_however_it_arrives(real: Recording, once: Thinned) -> None:
    found = [
        diagnose_thinned(arrived, gravity=GRAVITY).to_json()
        for arrived in (once, thinned(real, 777))
    ]
    assert found[0] == found[1]
    assert [f["effect"] for f in found[0]["findings"]] == ["gyro_g_sensitivity"]


def test_what_is_left_has_all_turns_and_windows_of_the_rests(real: Recording) -> None:
    poses = find_poses(real)
    left = thinned(real, 900)
    assert left.found == len(poses)
    assert len(left.poses) == len(poses)
    rest = left.poses.stop - left.poses.start
    assert rest.sum() <= 6144
    assert (rest <= poses.stop - poses.start).all()
    at = np.searchsorted(real.time, left.recording.time)
    np.testing.assert_array_equal(real.accel[at], left.recording.accel)
    for a, b in zip(poses.stop[:-1], poses.start[1:], strict=True):
        assert np.isin(np.arange(a, b), at).all()
    np.testing.assert_allclose(left.poses.interval, poses.interval)
    np.testing.assert_array_equal(np.diff(at) - 1, left.recording.lost[1:])
    # Nothing is integrated across what was left out.
    assert left.seen.spoilt[left.recording.lost > 0].all()


def test_motion_that_is_too_long_keeps_its_ends() -> None:
    real = recording(poses=8)
    rng = np.random.default_rng(0)
    poses = find_poses(real)
    at = int(poses.stop[3] - 5)
    shaken = 3000
    dt = real.interval
    gyro = 3 * np.sin(2 * np.pi * 0.7 * dt * np.arange(shaken))[:, None] * [1.0, 0.3, -0.4]
    accel = np.tile(real.accel[at], (shaken, 1)) + rng.normal(0, 3, (shaken, 3))
    long = Recording(
        dt * np.arange(len(real) + shaken),
        np.insert(real.accel, at, accel, axis=0),
        np.insert(real.gyro, at, gyro, axis=0),
        "device",
    )
    left = thinned(long, 1000)
    gap = left.poses.start[1:] - left.poses.stop[:-1]
    assert gap.max() * dt > 30.0
    assert gap.max() < 0.75 * shaken
    assert left.poses.interval[-1, 1] > long.time[-1] - 5.0


def test_a_long_motion_without_a_rest_is_undetermined() -> None:
    rng = np.random.default_rng(2)
    time = 0.01 * np.arange(20_000)
    rate = np.stack([np.sin(0.5 * time), 0.8 * np.cos(0.4 * time), 0.5 * np.sin(0.3 * time)], 1)
    force = np.stack([np.sin(0.5 * time), np.cos(0.4 * time), np.full(len(time), 9.8)], axis=1)
    noise = rng.normal(0, 1.0, (2, *rate.shape)) * [[[0.02]], [[0.003]]]
    moving = Recording(time, force + noise[0], rate + noise[1], "device")
    found = diagnose_thinned(thinned(moving, 4096), gravity=GRAVITY)
    assert found.verdict == "undetermined"
    assert found.missing[-1].startswith("a moment of rest")
    assert found.summary["samples"] == len(moving)


def test_faults_are_seen_in_every_section() -> None:
    real = recording(poses=8)
    limit = 0.7 * np.abs(real.gyro[:, 0]).max()
    clipped = replace(
        real,
        gyro=np.clip(real.gyro, -limit, limit),
        device=replace(real.device, gyro_full_scale=limit),
    )
    whole = diagnose_recording(clipped, gravity=GRAVITY)
    left = thin(lambda: (clipped,), whole=100, section=512)
    (item,) = left.seen.findings
    (known,) = [f for f in whole.findings if f.effect == "saturation"]
    assert item.effect == "saturation"
    assert item.channels == known.channels
    assert item.intervals == known.intervals
    at = np.searchsorted(clipped.time, left.recording.time)
    np.testing.assert_array_equal(
        left.seen.spoilt & (left.recording.lost == 0),
        (np.abs(clipped.gyro[at]) >= 0.999 * limit).any(axis=1),
    )


def test_a_day_of_one_channel_stuck_is_fatal() -> None:
    real = recording(poses=8)
    gyro = real.gyro.copy()
    gyro[:, 1] = 0.01
    left = thin(lambda: (replace(real, gyro=gyro),), whole=100, section=1024)
    assert left.seen.fatal
    assert {u.channels for u in left.seen.unexplained} == {("gyro.y",)}


def test_sections_are_cut_by_number_of_samples() -> None:
    real = recording(poses=4)
    for size in (7, 100, 10**6):
        cut = list(sections(batches(real, size), 300))
        assert [len(part) for part in cut[:-1]] == [300] * (len(cut) - 1)
        assert same(real, replace(real, time=np.concatenate([part.time for part in cut])))


def test_rests_are_found_in_parts_as_in_the_whole() -> None:
    real = recording(poses=10)
    poses = find_poses(real)
    for size in (3, 64, 1001):
        finder = RestFinder(real)
        for part in batches(real, size):
            finder.add(part)
        start, stop = finder.find()
        np.testing.assert_array_equal(start, poses.start)
        np.testing.assert_array_equal(stop, poses.stop)
        np.testing.assert_allclose(finder.accel(start, stop), poses.accel, atol=1e-9)


def test_of_many_poses_unlike_turns_are_chosen_from_all_over() -> None:
    rng = np.random.default_rng(1)
    # A thousand rests in one place, that were knocked; sixty poses of a bench session.
    accel = np.tile([0.0, 0.0, 9.8], (1000, 1))
    poses = rng.normal(size=(60, 3))
    accel = np.vstack((accel, 9.8 * poses / np.linalg.norm(poses, axis=1, keepdims=True)))
    start = 1000 * np.arange(1060)
    stop = start + 800
    stop[500] += 150
    chosen = choose_poses(accel, start, stop, interval=0.01)
    assert len(chosen) == MOST
    assert (np.diff(chosen) > 0).all()
    assert np.isin(np.arange(1000, 1060), chosen).mean() > 0.8
    assert 500 in chosen
    # Where all are alike, they come from everywhere.
    spread = choose_poses(accel[:1000], start[:1000], stop[:1000], interval=0.01)
    assert np.diff(spread).max() < 80
    np.testing.assert_array_equal(
        choose_poses(accel[:MOST], start[:MOST], stop[:MOST], interval=0.01), np.arange(MOST)
    )


def test_what_was_read_twice_is_left_out_in_sections_as_in_one() -> None:
    plain = recording(Term("gyro_g_sensitivity", {"gxx": 5e-4, "gzy": -5e-4}))
    index = np.repeat(np.arange(len(plain)), 2)
    time = plain.time[0] + 0.5 * plain.interval * np.arange(len(index))
    twice = Recording(time, plain.accel[index], plain.gyro[index], clock="host")
    for whole in (1500, 1 << 19):
        expected = thin(lambda: (plain,), whole=whole, section=1024, resting=6144)
        found = thin(lambda: batches(twice, 777), whole=whole, section=2048, resting=6144)
        assert np.array_equal(found.recording.accel, expected.recording.accel)
        assert np.array_equal(found.recording.gyro, expected.recording.gyro)
        (again,) = (f for f in found.seen.findings if f.effect == "dropped_samples")
        assert again.parameters["count"].value == -len(plain)
        assert "read faster than it measures" in again.sentence
