"""What to do about something that has no name: the next step, by its kind."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from calib.mismatch.search.separate import OF_MOTION

AGAIN = "repeat the recording: what the sensor has comes back, what happened once does not"

_STEPS = (
    ("a line at ", "look for a motor, a fan or mains at this frequency; repeat without it"),
    ("noise is louder", "look for what vibrates or is switched there; repeat without it"),
    ("pulses", "check supply and cable for what is switched; repeat the recording"),
    ("a jolt", "see that nothing knocks at the bench or pulls at the cable; repeat the recording"),
    ("a slip of the sensor", "see that the sensor sits firmly in its mount; repeat the recording"),
    ("a jump between", "see that the sensor sits firmly on what is tracked; repeat the recording"),
    ("turned axes", "see that the sensor sits firmly in its mount; repeat the recording"),
    ("samples are off course", "check cable and bus: single samples are damaged on their way"),
    ("it is stuck", "check wiring and driver of this channel"),
    ("not in the order", "check how the log is written: blocks of it are swapped"),
    ("wraps around", "check how wide the driver's numbers are, or choose a larger full scale"),
    ("would have been falling", "check wiring and supply: the accelerometer lost its 1 g there"),
    ("it is restless", "check the cable of this channel, and what touches the sensor there"),
    ("as if the recording had paused", "see that the logger keeps up; repeat the recording"),
    (
        "this one turn",
        "repeat the recording; if it is off again, see what the cable does there",
    ),
    (
        "turns: they do not close",
        "see what is loose, or comes late, then (samples of one triad, a mount); repeat it",
    ),
    ("too few of them", "record more poses, spread over all directions"),
    ("in a part of the recording", "look for what changed where it begins or ends, and repeat"),
    ("fading from the start", "let the sensor rest for 20 s, hands off, before it is turned first"),
    (
        "fluctuation",
        "look for a loose cable, a magnet or moving air then; repeat the recording",
    ),
    ("in a window", "look for what was touched, moved or switched on then; repeat the recording"),
    ("gain in time", "repeat it after a warm-up of 15 min, at an even temperature and supply"),
    (
        "moves to another",
        "look for what warms or creeps then (supply, mount, cable); repeat",
    ),
    ("wave throughout", "look for what comes and goes in that time, as a heating does; repeat"),
    ("orientation", "look for magnets and iron nearby; record the same poses at other headings"),
)
"""What is in the words of a kind, and what to do then; the first that fits counts."""


def next_step(left: Mapping[str, Any]) -> str:
    """Return what to check or to record next, of something unexplained."""
    follows = left["follows"]
    for words, step in _STEPS:
        if words in follows:
            return step
    return f"record {OF_MOTION[follows]}" if follows in OF_MOTION else AGAIN
