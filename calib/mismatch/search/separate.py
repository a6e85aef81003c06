"""What to record so that a finding and its rivals come apart."""

from __future__ import annotations

from calib.effects import effects
from calib.effects.base import Effect
from calib.mismatch.findings.diagnosis import Rival
from calib.mismatch.hypotheses.followed import LEVEL
from calib.mismatch.hypotheses.remembered import LOADED
from calib.mismatch.hypotheses.rivals import SIGN
from calib.mismatch.search.twins import HEADING

_CLOCK = ("warm_up", "bias_step")
_HEAT = ("temperature", "temperature_rate")

_AGAIN = "the same once more: what the sensor has comes back, what happened once does not"

OF_MOTION = {
    "rate and direction of gravity": "turns at several rates about axes that point several ways",
    "its own rate": "turns at several rates, both ways",
    "rate about the other axes": "slow and fast turns about one axis at a time",
    "speed of rotation": "slow and fast turns about every axis",
    "direction of gravity": "more poses, spread over all directions",
    "orientation": "the same poses with the bench turned to other headings",
    "the pose before": "the same poses in another order",
    LOADED: "the same poses, reached by other ways",
    "the turn before": "the same poses, reached by other turns",
    "temperature": "the same poses at other temperatures",
    "temperature and direction of gravity": "the same poses at other temperatures",
    "temperature and rate about the other axes": "the same turns at other temperatures",
    "time since the last turn": "long rests after turns about one axis at a time, slow and fast",
    LEVEL: "more poses, and turns at more rates, on either side of it",
    SIGN: "the counts as the converter gives them, before a host scales or cuts them",
    HEADING: "the same beside a reference that keeps its heading, as markers do",
}
"""What tells a function of the motion from physics; of time, a repetition does."""


def to_separate(effect: Effect, rivals: tuple[Rival, ...]) -> str:
    """Say what to record so that a finding and its rivals come apart."""
    if not rivals:
        return ""
    slugs = [effect.slug, *(r.effect for r in rivals)]
    clock = any(s.endswith(_CLOCK) or s.startswith("time ") for s in slugs)
    heat = any(s.endswith(_HEAT) for s in slugs)
    if clock and heat:
        return (
            "Cool the sensor by as much as it warmed while you repeat the poses, in the same "
            "recording and without switching it off, so that temperature and time since power-on "
            "do not rise together."
        )
    known = effects()
    parts = [f"{known[s].title}: {known[s].needs}" for s in slugs if s in known]
    for s in (s for s in slugs if s not in known):
        parts.append(f"{s}: {OF_MOTION.get(s, OF_MOTION.get(s.rpartition(' ')[0], _AGAIN))}")
    return "To tell them apart, record what each needs. " + "; ".join(parts) + "."
