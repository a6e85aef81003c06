"""Physics that the published model leaves out: one file per effect, each with one ``EFFECT``.

To add an effect, add a file here with an `Effect` named ``EFFECT``. The simulator, ``apply``,
``show``, the diagnosis and ``tests/test_registry.py`` find it by itself.
"""

from __future__ import annotations

from functools import cache
from typing import Any

from calib.effects.base import Effect, Term
from calib.registry import discover


@cache
def effects() -> dict[str, Effect]:
    """Return every effect of the catalogue by its slug, in alphabetical order."""
    kind: Any = Effect  # mypy takes only concrete classes for type[T]
    return discover(__name__, __path__, attribute="EFFECT", kind=kind, key="slug")


def get_effect(slug: str) -> Effect:
    """Return one effect; ValueError names the known ones if there is none."""
    try:
        return effects()[slug]
    except KeyError:
        known = ", ".join(effects())
        raise ValueError(f"`slug` {slug!r} is no effect of the catalogue: {known}") from None


def shape_of(term: Term) -> dict[str, float]:
    """Return the shape parameters that a term states."""
    names = [item.name for item in get_effect(term.effect).shape]
    return {n: term.parameters[n] for n in names if n in term.parameters}
