"""One disturbance is one item, in one place."""

from __future__ import annotations

from dataclasses import replace

import pytest

from calib.mismatch.findings.diagnosis import Unexplained
from calib.mismatch.hypotheses.places import gathered, joined
from calib.mismatch.hypotheses.rivals import FROM_START


def piece(
    channel: str, start: float, stop: float, follows: str = "bias in a window"
) -> Unexplained:
    return Unexplained((channel,), ((start, stop),), follows, 1e-6)


@pytest.mark.parametrize(
    ("pieces", "expected"),
    [
        # Pieces with a small gap are one; those far apart are two.
        ([("gyro.x", 10, 20), ("gyro.x", 23, 30)], [(10, 30)]),
        ([("gyro.x", 10, 20), ("gyro.x", 40, 50)], [(10, 20), (40, 50)]),
        # What lies between joins what was apart.
        ([("gyro.x", 10, 20), ("gyro.x", 30, 40), ("gyro.x", 18, 32)], [(10, 40)]),
        # Another channel is part of it only at the same time.
        ([("gyro.x", 10, 20), ("accel.y", 11, 21)], [(10, 21)]),
        ([("gyro.x", 10, 20), ("accel.y", 18, 30)], [(10, 20), (18, 30)]),
    ],
)
def test_pieces_of_one_disturbance_are_joined(pieces, expected):
    found = joined([piece(*p) for p in pieces])
    assert [item.intervals[0] for item in found] == expected
    assert {c for item in found for c in item.channels} == {p[0] for p in pieces}


@pytest.mark.parametrize("wide", [("gyro.x", "gyro.y", "gyro.z"), ("gyro.z",)])
def test_the_surer_of_two_has_its_own_channels_where_one_has_those_of_the_other(wide):
    weak = replace(piece("gyro.x", 10, 20), channels=wide, p_value=1e-6)
    other = ("gyro.z",) if len(wide) > 1 else ("gyro.x", "gyro.y", "gyro.z")
    sure = replace(piece("gyro.x", 11, 21), channels=other, p_value=1e-18)
    (found,) = joined([weak, sure])
    assert found.channels == other


def test_waves_of_several_periods_throughout_are_one_that_is_no_sine():
    items = [piece("gyro.x", 0, 100, "wave throughout") for _ in range(2)]
    other = piece("gyro.y", 0, 100, "wave throughout")
    found = joined([items[0], other, items[1]])
    assert [item.channels for item in found] == [("gyro.x",), ("gyro.y",)]


def test_what_fades_from_the_start_is_a_piece_of_what_the_first_rest_has():
    items = [piece("gyro.x", 0, 16), piece("gyro.x", 0, 3, FROM_START)]
    (found,) = joined(items)
    assert found.intervals == ((0, 16),)


def test_what_goes_with_the_direction_everywhere_is_no_piece_of_a_window():
    items = [piece("gyro.x", 10, 20), piece("gyro.x", 0, 100, "direction of gravity")]
    assert joined(items) == items


def test_what_rests_far_apart_show_of_a_triad_is_one_item_in_several_places():
    loud, narrow = "the time: noise is louder there", "the time: power at one frequency there"
    items = [
        piece("gyro.x", 0, 10, narrow),
        piece("gyro.y", 50, 60, narrow),
        piece("gyro.z", 55, 70, narrow),
        piece("accel.x", 20, 30, loud),
        piece("gyro.x", 80, 90),
        piece("gyro.x", 20, 30),
    ]
    found = gathered(items)
    assert [item.channels for item in found[:2]] == [
        ("gyro.x", "gyro.y", "gyro.z"),
        ("accel.x",),
    ]
    assert found[0].intervals == ((0, 10), (50, 70))
    # What has an end of its own, in the rows, is a disturbance of its own.
    assert found[2:] == items[4:]
