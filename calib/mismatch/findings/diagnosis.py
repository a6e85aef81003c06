"""The diagnosis: a verdict, findings, and what stays unexplained, as data and as JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from calib.calibration import (
    Calibration,
    Event,
    Gravity,
    Provenance,
    Quantity,
    TemperatureRange,
)
from calib.compare import Difference, compare
from calib.effects import get_effect
from calib.effects.base import Term
from calib.errors import InsufficientMotionError
from calib.mismatch.findings.aliases import Alias
from calib.mismatch.findings.evidence import Evidence
from calib.mismatch.findings.heldout import HeldOut
from calib.mismatch.noise.hush import HUSHED
from calib.model import SensorModel
from calib.read_once import HELD
from calib.recording import Recording
from calib.rounded_stamps import ROUNDED
from calib.timing import EVENED, SHARED
from calib.types import FloatArray

Verdict = Literal["consistent", "explained", "partly_explained", "unexplained", "undetermined"]
"""``consistent``: nothing beyond noise. ``explained``: everything beyond noise has a name.
``undetermined``: the recording cannot tell, and ``missing`` says what it lacks."""

Interval = tuple[float, float]

_OPEN = {"bias": 0.5, "scale_factor_error": 0.1, "misalignment": 0.1}
"""Standard errors (SI) beyond which a baseline parameter counts as undetermined."""


@dataclass(frozen=True)
class Absorbed:
    """A baseline parameter that had taken up part of an effect, and by how much."""

    parameter: str
    shift: float
    unit: str
    standard_errors: float


@dataclass(frozen=True)
class Rival:
    """Another name that explains the same; ``odds`` are its own against the finding's."""

    effect: str
    odds: float


@dataclass(frozen=True, eq=False)
class Finding:
    """Physics that was left out."""

    effect: str
    title: str
    kind: str
    channels: tuple[str, ...]
    intervals: tuple[Interval, ...]
    regime: str
    parameters: Mapping[str, Quantity]
    p_value: float
    absorbed_by: tuple[Absorbed, ...]
    held_out: HeldOut | None
    held_out_reason: str
    rivals: tuple[Rival, ...]
    to_separate: str
    sentence: str
    evidence: Evidence | None = None

    def term(self) -> Term:
        """Return the finding as a term of a sensor model."""
        return Term(self.effect, {k: q.value for k, q in self.parameters.items()})

    def event(self) -> Event:
        """Return the finding as an event of the recording."""
        return Event(self.effect, self.channels, self.intervals, self.parameters)

    def to_json(self) -> dict[str, Any]:
        """Return the finding as JSON."""
        held = self.held_out
        return {
            "effect": self.effect,
            "title": self.title,
            "kind": self.kind,
            "channels": list(self.channels),
            "intervals": [list(i) for i in self.intervals],
            "regime": self.regime,
            "parameters": {
                name: {"value": q.value, "sigma": q.sigma, "unit": q.unit}
                for name, q in self.parameters.items()
            },
            "p_value": self.p_value,
            "absorbed_by": [vars(a) for a in self.absorbed_by],
            "held_out": None
            if held is None
            else {
                "before": held.before,
                "after": held.after,
                "noise_floor": held.noise_floor,
                "unit": held.unit,
                "rows": held.rows,
                "log_likelihood_gain": held.gain,
                "channels": {
                    name: {"before": before, "after": after}
                    for name, (before, after) in held.channels.items()
                },
            },
            "held_out_reason": self.held_out_reason or None,
            "rivals": [{"effect": r.effect, "odds": r.odds} for r in self.rivals],
            "to_separate": self.to_separate,
            "sentence": self.sentence,
            "evidence": None if self.evidence is None else self.evidence.to_json(),
        }


@dataclass(frozen=True)
class Unexplained:
    """Something is left that has no name here: where it is, and what it follows."""

    channels: tuple[str, ...]
    intervals: tuple[Interval, ...]
    follows: str
    p_value: float
    rivals: tuple[Rival, ...] = ()
    evidence: Evidence | None = field(default=None, compare=False)
    size: Quantity | None = None
    """The most that is seen of it in a mean at rest, beyond what the baseline takes up."""

    def to_json(self) -> dict[str, Any]:
        """Return it as JSON."""
        return {
            "channels": list(self.channels),
            "intervals": [list(i) for i in self.intervals],
            "follows": self.follows,
            "p_value": self.p_value,
            "size": None
            if self.size is None
            else {"value": self.size.value, "unit": self.size.unit},
            "rivals": [{"effect": r.effect, "odds": r.odds} for r in self.rivals],
            "evidence": None if self.evidence is None else self.evidence.to_json(),
        }


@dataclass(frozen=True)
class Change:
    """Residual RMS of one kind of rows before and after, with what noise alone would leave."""

    rows: str
    unit: str
    before: float
    after: float
    noise_floor: float


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What a recording has that its simulation lacks.

    Parameters
    ----------
    verdict : str
    findings : tuple of Finding
    unexplained : tuple of Unexplained
    missing : tuple of str
        What the recording lacks, for what it cannot tell.
    hidden : mapping of str to str
        Effects that this kind of recording cannot show at all, and why.
    changes : tuple of Change
        Residuals before and after, on the rows that were fitted.
    log_likelihood : (before, after)
    model : SensorModel
        With the findings that are terms of the sensor, as they stood when the rows were made;
        `calibration` has their values.
    names, covariance
        Of the model's determined parameters.
    undetermined : tuple of str
        Its parameters of which nobody can tell anything.
    summary : mapping
        Poses, turns, duration and clock of the recording.
    aliases : tuple of Alias
        Effects that would look like parameters of the twin.
    moved : tuple of Difference
        Parameters that are no longer what a calibration says, beyond what a sensor may do by
        itself.
    """

    verdict: Verdict
    findings: tuple[Finding, ...]
    unexplained: tuple[Unexplained, ...]
    missing: tuple[str, ...]
    hidden: Mapping[str, str]
    changes: tuple[Change, ...]
    log_likelihood: tuple[float, float] | None
    model: SensorModel
    names: tuple[str, ...]
    covariance: FloatArray
    summary: Mapping[str, Any] = field(default_factory=dict)
    aliases: tuple[Alias, ...] = ()
    moved: tuple[Difference, ...] = ()
    undetermined: tuple[str, ...] = ()

    def beside(self, known: Calibration, recording: Recording) -> Diagnosis:
        """Return the diagnosis with what has moved since the calibration that the twin is under.

        The twin is fitted to the recording, so that what moved is no effect, and leaves nothing.
        What a calibration states without any standard error is as it says.
        """
        if not self.names:
            return self
        now = self.calibration(recording, gravity=known.gravity)
        if not known.names:
            there = known.values.keys() - set(known.undetermined)
            stated = tuple(name for name in now.names if name in there)
            known = replace(known, names=stated, covariance=np.zeros((len(stated),) * 2))
        return replace(self, moved=compare(known, now).changed)

    def calibration(self, recording: Recording, *, gravity: Gravity) -> Calibration:
        """Return the sensor model that was found, as a calibration; events are kept apart.

        Raises
        ------
        InsufficientMotionError
            If nothing could be fitted to the recording.
        """
        if not self.names:
            raise InsufficientMotionError(
                "nothing could be fitted to this recording, and no model is written: it lacks "
                + "; ".join(self.missing)
            )
        temperature = None
        if recording.temperature is not None:
            low, high = float(recording.temperature.min()), float(recording.temperature.max())
            temperature = TemperatureRange(low, high)
        terms: dict[str, dict[str, float]] = {}
        for term in self.model.terms:
            terms[term.effect] = {**terms.get(term.effect, {}), **term.parameters}
        for item in self.findings:
            if item.kind == "sensor":
                terms[item.effect] = {
                    **terms.get(item.effect, {}),
                    **{k: q.value for k, q in item.parameters.items()},
                }
        found = tuple(Term(slug, values) for slug, values in terms.items())
        model = replace(
            self.model, terms=tuple(t for t in found if get_effect(t.effect).kind == "sensor")
        )
        scale = np.sqrt(np.diag(self.covariance))
        settled = [
            i for i, n in enumerate(self.names) if scale[i] < _OPEN.get(n.split(".")[1], np.inf)
        ]
        vague = tuple(n for i, n in enumerate(self.names) if i not in settled)
        covariance = self.covariance[np.ix_(settled, settled)]
        return Calibration(
            model=model,
            names=tuple(self.names[i] for i in settled),
            covariance=0.5 * (covariance + covariance.T),
            undetermined=(*vague, *self.undetermined),
            gravity=gravity,
            temperature=temperature,
            events=tuple(f.event() for f in self.findings if f.kind != "sensor"),
            provenance=Provenance(device=recording.device),
        )

    def to_json(self) -> dict[str, Any]:
        """Return the document that ``diagnose --json`` prints."""
        return {
            "format": "imu-cal/diagnosis",
            "version": 1,
            "verdict": self.verdict,
            "findings": [f.to_json() for f in self.findings],
            "unexplained": [u.to_json() for u in self.unexplained],
            "missing": list(self.missing),
            "cannot_show": dict(self.hidden),
            "aliases": [a.to_json() for a in self.aliases],
            "moved": [
                {
                    "parameter": d.name,
                    "shift": d.difference,
                    "sigma": d.sigma,
                    "unit": d.unit,
                    "standard_errors": abs(d.score),
                }
                for d in self.moved
            ],
            "fit": {
                "residuals": [vars(c) for c in self.changes],
                "log_likelihood": None
                if self.log_likelihood is None
                else {"before": self.log_likelihood[0], "after": self.log_likelihood[1]},
            },
            "recording": dict(self.summary),
        }


def without_fit(
    verdict: Verdict,
    missing: tuple[str, ...],
    summary: Mapping[str, object],
    *,
    findings: tuple[Finding, ...] = (),
    unexplained: tuple[Unexplained, ...] = (),
) -> Diagnosis:
    """Return the diagnosis of a recording that nothing could be fitted to."""
    return Diagnosis(
        verdict=verdict,
        findings=findings,
        unexplained=unexplained,
        missing=missing,
        hidden={},
        changes=(),
        log_likelihood=None,
        model=SensorModel(),
        names=(),
        covariance=np.zeros((0, 0)),
        summary=dict(summary),
    )


def claimed(model: SensorModel, given: Sequence[Term], findings: Sequence[Finding]) -> SensorModel:
    """Return a fitted model without the terms that were tried and have no name in the end.

    Nor with the parameters of a finding that the recording leaves open: it was fitted without them.
    What is given has all of its own, fitted along with the model. It stands first: more of the same
    effect was found beside it.
    """
    found = {f.effect: set(f.parameters) for f in findings}
    before, kept = [t.effect for t in given], []
    for term in model.terms:
        own = term.parameters
        if term.effect in before:
            before.remove(term.effect)
        else:
            own = {n: v for n, v in own.items() if n in found.get(term.effect, ())}
        if own:
            kept.append(Term(term.effect, own))
    return replace(model, terms=tuple(kept))


def summarise(recording: Recording) -> dict[str, object]:
    """Return what a diagnosis says of any recording."""
    return {
        "duration": recording.duration,
        "samples": len(recording),
        "rate": 1.0 / recording.interval if recording.interval else 0.0,
        "clock": recording.clock,
        **({"rounded_stamps": recording.notes[ROUNDED]} if ROUNDED in recording.notes else {}),
        **({"shared_stamps": recording.notes[SHARED]} if SHARED in recording.notes else {}),
        **({"stamps": recording.notes[EVENED]} if EVENED in recording.notes else {}),
        **({"held": recording.notes[HELD]} if HELD in recording.notes else {}),
        **({"silent": recording.notes[HUSHED]} if HUSHED in recording.notes else {}),
    }
