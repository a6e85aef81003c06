"""A term of the sensor model, as people write it on a command line or in an address."""

from __future__ import annotations

import difflib

from calib.effects import effects
from calib.effects.base import Term


def parse_term(text: str, *, span: tuple[float, float]) -> Term:
    """Return the term of ``slug:name=value,name=value`` in SI units, or of ``slug`` alone.

    Alone, or with shape parameters only, its linear parameters have their typical size. Moments are
    in ``span``, s. ValueError says what is wrong.
    """
    slug, _, rest = text.partition(":")
    if slug not in effects():
        near = difflib.get_close_matches(slug, effects(), n=1)
        hint = f": did you mean {near[0]}?" if near else f"; known: {', '.join(effects())}"
        raise ValueError(f"{slug!r} is no effect{hint}")
    effect = effects()[slug]
    given: dict[str, float] = {}
    for item in filter(None, rest.split(",")):
        name, equals, value = item.partition("=")
        name = name.strip()
        if name in given:
            raise ValueError(f"`{name}` is given twice in {text!r}")
        try:
            given[name] = float(value)
        except ValueError:
            shown = "no number" if equals else "no value"
            raise ValueError(f"{item!r} in {text!r} has {shown}: give name=value") from None
    effect.check_names(given)
    linear = {p.name for p in effect.parameters}
    if not linear & set(given):
        shape = {p.name for p in effect.shape}
        if not shape or not shape & set(given) or not all(p.optional for p in effect.shape):
            given = {**effect.typical(span=span), **given}
    effect.check(given)
    effect.check_moments(given, span=span)
    return Term(slug, given)
