"""What the further terms of a given model may have become: they are fitted with the baseline.

A part changes. Beside a truth that is told from what a calibration says by the same rows as all
else, so it is no effect, but a parameter that has moved. How far each may have is known roughly: by
no more than a few times what parts have at all (`FAR`). Where the motion does not tell it stays.

What acts on finished signals (a delay, a low-pass) is not in proportion, and stays as it is given:
a change of it is found as any other effect.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from calib.effects import get_effect, shape_of
from calib.effects.base import Column, State, Term, TransformEffect
from calib.mismatch.findings.diagnosis import Finding
from calib.model import SensorModel
from calib.types import FloatArray

FAR = 10.0
"""Times its typical size by which a parameter may have changed: no part has more."""

TOLD = 0.5
"""Standard error, of how far it may have moved, up to which motion tells of a parameter."""


class Further(NamedTuple):
    """A parameter of a further term, its typical size, and its name among what is fitted."""

    name: str
    typical: float
    label: str

    @property
    def loose(self) -> float:
        """How far it may have moved."""
        return FAR * self.typical


def further_of(terms: Iterable[Term], state: State, *, beside: Sequence[str]) -> list[Further]:
    """Return the parameters of terms that show in a state; none that is fitted ``beside`` them.

    Those that a term does not state are zero in it. Of what has a shape another one may be found
    beside it, so that it goes by another name there.
    """
    out = []
    for term in terms:
        effect = get_effect(term.effect)
        if effect.kind != "sensor" or isinstance(effect, TransformEffect):
            continue
        sizes = {p.name: p.typical for p in effect.parameters}
        for name in effect.columns(state, shape_of(term)):
            full = f"{term.effect}.{name}"
            if full not in beside:
                out.append(Further(full, sizes[name], f"given.{full}" if effect.shape else full))
    return out


def further_columns(
    terms: Iterable[Term], further: Sequence[Further], state: State
) -> list[Column]:
    """Return what one unit of each parameter adds to the signals."""
    columns = {
        f"{term.effect}.{name}": column
        for term in terms
        if any(f.name.startswith(f"{term.effect}.") for f in further)
        for name, column in get_effect(term.effect).columns(state, shape_of(term)).items()
    }
    return [columns[f.name] for f in further]


def moved_terms(
    terms: tuple[Term, ...], further: Sequence[Further], steps: FloatArray
) -> tuple[Term, ...]:
    """Return terms with parameters moved by steps."""
    by_name = {f.name: float(s) for f, s in zip(further, steps, strict=True) if s}
    return SensorModel(terms=terms).with_terms_moved(by_name).terms if by_name else terms


def with_given(finding: Finding, terms: Iterable[Term]) -> Finding:
    """Return a finding with the whole of what the sensor has, of which a model gives a part.

    What was found beside a delay that is given is how much longer it has become.
    """
    own = next((t for t in terms if t.effect == finding.effect), None)
    if own is None or finding.kind != "sensor" or get_effect(finding.effect).shape:
        return finding
    whole = {
        name: replace(q, value=q.value + own.parameters.get(name, 0.0))
        for name, q in finding.parameters.items()
    }
    return replace(finding, parameters=whole)


def told_further(further: Sequence[Further], first: int, sigma: FloatArray) -> dict[str, int]:
    """Return which coefficients of a fit, the first of them at ``first``, motion tells, by name."""
    loose = np.array([f.loose for f in further])
    own = sigma[first : first + len(loose)]
    return {
        f.name: first + k
        for k, (f, told) in enumerate(zip(further, own < TOLD * loose, strict=True))
        if told
    }
