"""What a diagnosis is in words: the same on a screen and on a page."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from calib.effects import get_effect
from calib.effects.base import SAMPLES
from imu_cli.report.units import people_unit, said

VERDICTS = {
    "consistent": ("Consistent: nothing beyond noise.", "good"),
    "explained": ("Explained: everything beyond noise has a name.", "good"),
    "partly_explained": ("Partly explained: something is left that has no name here.", "partial"),
    "unexplained": ("Unexplained: something is there that is not in the catalogue.", "bad"),
    "undetermined": ("Undetermined: this recording cannot tell.", "partial"),
}
"""Sentence and tone of each verdict."""


SEEN = "nothing: "
"""How begins what is no function of anything, but is seen in samples."""


OR_ANOTHER = "Explained: everything beyond noise has a name, or one of several."
"""The sentence where other names are as good, or nearly, for some of it."""

MENDED_FIRST = "Explained so far: this has to be mended first, and nothing else was looked at."
"""The sentence where units or axes are wrong: nothing was compared."""

NEARLY = 0.1
"""Odds of a rival from which on it is said to be as good, or nearly."""


def headline(document: Mapping[str, Any]) -> str:
    """Return the verdict as a sentence."""
    fit = document.get("fit")
    if document["verdict"] == "explained" and fit is not None and not fit["residuals"]:
        return MENDED_FIRST
    rivals = [r for f in document.get("findings", ()) for r in f.get("rivals", ())]
    if document["verdict"] == "explained" and any(r["odds"] >= NEARLY for r in rivals):
        return OR_ANOTHER
    if document["verdict"] == "consistent" and document.get("moved"):
        return "Consistent with a calibration brought up to date: nothing else beyond noise."
    return VERDICTS[document["verdict"]][0]


def chance(p_value: float) -> str:
    """Write a p-value; below a millionth the noise model is not to be trusted to the digit."""
    return "< 1e-6" if p_value <= 1e-6 else f"{p_value:.2g}".replace("e-0", "e-")


SPELT = 8
"""Intervals that are written one by one, at most; the JSON has all of them."""


def spans(intervals: Sequence[Sequence[float]], separator: str = ", ", *, digits: int = 1) -> str:
    """Write intervals in the recording's seconds: the first few of very many."""
    # Adding 0 makes a plain zero of what rounds to minus zero.
    shown = intervals if len(intervals) <= SPELT else intervals[: SPELT - 1]
    ends = [[f"{round(t, digits) + 0.0:.{digits}f}" for t in interval] for interval in shown]
    parts = [f"{start} to {stop} s" for start, stop in ends]
    if len(shown) < len(intervals):
        last = round(max(stop for _, stop in intervals), digits) + 0.0
        parts.append(f"and {len(intervals) - len(shown)} more until {last:.{digits}f} s")
    return separator.join(parts)


def where(finding: Mapping[str, Any]) -> str:
    """Return on which channels a finding is, when, and what it follows."""
    parts = (", ".join(finding["channels"]), spans(finding["intervals"]))
    return "; ".join((*(part for part in parts if part), f"follows {finding['regime']}"))


def rival_of(rival: Mapping[str, Any]) -> str:
    """Return what something that was found may be instead, and how probable that is beside it."""
    times = f"{rival['odds']:.2g}"
    name = re.sub(r" ((?:accel|gyro)(?:\.[xyz])?)$", r" (\1)", rival["effect"])
    return f"{name}, {'just' if times == '1' else f'{times} times'} as probable"


ALTERNATIVES = 5
"""So many rivals are said; the document has all."""


VAGUE = 3.0
"""Standard errors below which a time constant or a cut-off is not known in size."""


def alternatives(rivals: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return what something that was found may be instead, in a line each, the likeliest first."""
    ordered = sorted(rivals, key=lambda r: -float(r["odds"]))
    out = []
    for rival in ordered[:ALTERNATIVES]:
        more = float(f"{rival['odds']:.2g}") > 1.0
        out.append(f"{'or, more probable' if more else 'or'}: {rival_of(rival)}")
    if left := len(ordered[ALTERNATIVES:]):
        out.append(f"and {left} less probable one{'s' if left > 1 else ''}")
    return out


_TURNING = re.compile(r"\brates?\b(?! of temperature)|speed of rotation")


def much(left: Mapping[str, Any], fit: Mapping[str, Any]) -> str:
    """Return the most that is seen of something unexplained, and in what; nothing if unknown.

    What follows how fast the sensor turns does not show at rest.
    """
    size = left.get("size")
    rows = [item["rows"] for item in fit.get("residuals", ())]
    at_rest = not rows or any(name.endswith("at rest") for name in rows)
    if size is None or (at_rest and _TURNING.search(left["follows"])):
        return ""
    unit, factor = people_unit(size["unit"])
    where = "at rest" if at_rest else "in the mean of a window"
    return f"up to {size['value'] * factor:.3g} {unit} {where}"


def remarks(finding: Mapping[str, Any]) -> list[str]:
    """Return what is to be said of the numbers of a finding."""
    out = []
    shape = {item.name: item.spacing for item in get_effect(finding["effect"]).shape}
    for name, item in finding["parameters"].items():
        value, sigma = item["value"], item["sigma"]
        if item["unit"] == SAMPLES:
            many = f"{abs(value):g} sample{'s are' if abs(value) != 1 else ' is'}"
            out.append(f"{many} {'repeated' if value < 0 else 'missing'}.")
        elif shape.get(name) == "log" and sigma is not None and sigma > value / VAGUE:
            out.append(f"{name}: the effect is sure, this number is not.")
    return out


def shift_of(absorbed: Mapping[str, Any]) -> str:
    """Return by how much a parameter had moved to take something up."""
    unit, factor = people_unit(absorbed["unit"])
    return f"{absorbed['shift'] * factor:+.3g} {unit}"


def what(follows: str) -> str:
    """Return in words what something without a name follows, or what is seen of it."""
    seen = follows.removeprefix(SEEN)
    return seen if seen != follows else f"follows {follows}"


def likelihood(fit: Mapping[str, Any]) -> str:
    """Return the log-likelihood before and after; nothing where nothing was fitted, or changed."""
    both = fit.get("log_likelihood")
    if both is None:
        return ""
    before, after = (f"{both[key]:.1f}" for key in ("before", "after"))
    return f"Log-likelihood: {before} -> {after}." if before != after else ""


def alias_sentence(alias: Mapping[str, Any]) -> str:
    """Return what cannot be known, of one entry of ``aliases``."""
    sizes = ", ".join(f"{name} = {said(**q)}" for name, q in alias["parameters"].items())
    return (
        f"{alias['alias_of']} is {said(**alias['common'])} on all axes alike; "
        f"{alias['effect']} ({sizes}) would look the same. It needs {alias['needs']}."
    )


def moved_lines(document: Mapping[str, Any]) -> list[str]:
    """Return what has moved since a calibration, a parameter each; nothing where it still holds."""
    return [
        f"{item['parameter']} by {said(item['shift'], item['sigma'], item['unit'])}"
        for item in document.get("moved", ())
    ]


def notes(document: Mapping[str, Any]) -> list[str]:
    """Return what was done to the recording before it was judged, one sentence each."""
    recording = document.get("recording") or {}
    out = []
    known, used = recording.get("poses", 0), recording.get("poses_used", 0)
    if used < known:
        out.append(
            f"{used} of {known} poses were looked at: those at rest throughout, and of very many "
            "those beside the most unlike turns."
        )
    if "bumped" in recording:
        out.append(
            f"The sensor was bumped in a rest at {spans(recording['bumped'], digits=2)}: such a "
            "pose counts as two, one before and one after."
        )
    if "rounded_stamps" in recording:
        out.append(f"Time stamps are rounded {recording['rounded_stamps']}.")
    if "shared_stamps" in recording:
        out.append(f"Several samples share a time stamp: {recording['shared_stamps']}.")
    if "stamps" in recording:
        out.append(
            f"Time stamps scatter by {recording['stamps']}, but samples were taken evenly: even "
            "times were used."
        )
    if "held" in recording:
        out.append(
            f"Samples of the {recording['held']} come again until there is a new one: it is read "
            "more often than it measures. Between its own its course was followed by cubics."
        )
    if "up" in recording:
        out.append(
            f"In the world of the reference {recording['up']} is up: it was turned until that is z."
        )
    if "swapped_markers" in recording:
        left = recording["swapped_markers"]
        out.append(
            f"{left['samples']} samples of the reference were left out: one marker was taken for "
            f"another at {spans(left['intervals'], digits=2)}."
        )
    if "jumps" in recording:
        left = recording["jumps"]
        out.append(
            f"{left['samples']} samples were left out: the motion jumped between two of them at "
            f"{spans(left['intervals'], digits=2)}, as what is let go does, and neither tells when."
        )
    if "compared" in recording:
        part = recording["compared"]
        out.append(
            f"Compared were {part['seconds']:.3g} s of {recording['duration']:.3g} s, from "
            f"{part['from']:.1f} to {part['to']:.1f} s: nothing is said of the rest, which the "
            "other does not know."
        )
    if "corners" in recording:
        out.append(
            f"{recording['corners']} samples were left out: those of the simulation are too few to "
            "follow the corners of its motion there."
        )
    if "own_axes" in recording:
        out.append(
            "The accelerometer is turned against the frame of the other, and the gyroscope is "
            "not by as much: its axes were fitted as they are."
        )
    if "silent" in recording:
        out.append(
            f"Without noise: {recording['silent']}; they count as noisy as the quietest sensor is."
        )
    return out
