"""What the effects of the catalogue can look like in the signals."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np

from calib.effects import effects, get_effect
from calib.effects.base import State
from calib.types import FloatArray


def catalogue_shapes(state: State) -> Iterator[tuple[str, FloatArray]]:
    """Yield what effects of typical size make of a state: channel and values."""
    for slug, effect in effects().items():
        if effect.is_readout or any(s.low is None or s.high is None for s in effect.shape):
            continue
        # What a higher order adds is as noisy as it is steep, and much like the lower ones.
        sizes = {p.name: p.typical for p in effect.parameters if not p.refining}
        for shape in _few_shapes(slug):
            columns = effect.columns(state, shape)
            for parameter in (name for name in columns if name in sizes):
                for channel, values in columns[parameter].items():
                    yield channel, sizes[parameter] * values


def _few_shapes(slug: str) -> Iterator[dict[str, float]]:
    """Yield three values of each shape parameter of an effect."""
    items = get_effect(slug).shape
    optional = [s for s in items if s.optional and s.spacing != "integer"]
    for choice in [[s] for s in optional] or [[]]:
        used = [s for s in items if s.spacing != "integer" and not s.optional] + choice
        grids = [np.geomspace(s.low or 1e-3, s.high or 1.0, 5)[1:4] for s in used]
        for values in product(*grids):
            yield {s.name: float(v) for s, v in zip(used, values, strict=True)}
