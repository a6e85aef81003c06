"""The catalogue as candidates: every effect, its parameters singly and together, every shape."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping
from itertools import product

import numpy as np

from calib.effects import effects, get_effect
from calib.effects.base import PRESENCE, Effect, ShapeParameter, TransformEffect
from calib.mismatch.hypotheses.candidates import Candidate
from calib.mismatch.hypotheses.factors import LARGE
from calib.mismatch.hypotheses.score import Stack
from calib.mismatch.rows.onset import Onset
from calib.mismatch.rows.resolved import are_resolved
from calib.mismatch.rows.restored import whole_changes
from calib.mismatch.rows.rows import Kind, Rows
from calib.recording import CHANNELS
from calib.types import FloatArray

SHAPES = 7
"""Candidates for each continuous shape parameter (its grid is refined once it was chosen)."""

NEAR = 17
"""Values of a shape parameter between those of its grid that are tried to refine it."""

UNSEEN = 0.1
"""Standard errors that a parameter must add at its largest, over all rows, to be one of a
candidate: of an axis that never turns, rounding errors are all that there is to see. A setup is one
thing, an arm or a rotation, of which the open part is said too."""

PHYSICAL = 0.6
"""Prior probability of all physics together that such rows may show; the rivals share the rest."""


def add_catalogue(
    stack: Stack, rows: Rows, *, skip: tuple[str, ...] = (), reference: bool = False
) -> None:
    """Add the candidates of every effect that can show in these rows.

    Parameters
    ----------
    stack : Stack
    rows : Rows
    skip : tuple of str
        Effects that are not tried.
    reference : bool
        Whether the rows compare with a reference, which some parameters need.
    """
    tried = tried_effects(skip=skip, reference=reference)
    noise = np.sqrt(np.concatenate((rows.expected_variance(), rows.white_diagonal)))
    for effect in tried:
        _add(stack, effect, rows, noise, reference=reference, weight=PHYSICAL / len(tried))


def tried_effects(*, skip: tuple[str, ...] = (), reference: bool = False) -> list[Effect]:
    """Return the effects that rows can show: not what only samples do, or only a reference."""
    out = []
    for slug, effect in effects().items():
        # What acts on the readout (clipping, rounding, a unit) shows in the samples, not in rows.
        unseen = not reference and all(p.reference_only for p in effect.parameters)
        if slug not in skip and not unseen and (not effect.is_readout or slug == "dropped_samples"):
            out.append(effect)
    return out


def _add(
    stack: Stack,
    effect: Effect,
    rows: Rows,
    noise: FloatArray,
    *,
    reference: bool,
    weight: float,
) -> None:
    """Add an effect's candidates; their weights sum to `weight`. ``noise`` (m,) is each row's."""
    shapes = list(_shapes(effect, rows))
    channels = {p.name: p.channels for p in effect.parameters}
    units = {p.name: p.unit for p in effect.parameters}
    refining = tuple(p.name for p in effect.parameters if p.refining)
    found: list[tuple[Mapping[str, float], dict[str, FloatArray]]] = []
    for shape in shapes:
        columns = effect_columns(effect, rows, shape, reference=reference)
        if effect.kind != "setup":
            columns = {
                n: v for n, v in columns.items() if LARGE * np.linalg.norm(v / noise) > UNSEEN
            }
        if columns:
            found.append((shape, columns))
    if not found:
        return
    # As likely in one triad as in the other, or both, in however many forms each can be.
    alike = Counter(frozenset(shape) for shape in shapes)
    number = _added(stack, rows, [v for _, columns in found for v in columns.values()])
    for shape, columns in found:
        index = dict(zip(columns, number, strict=False))
        every = tuple(columns)
        subsets: Iterable[tuple[tuple[str, ...], float]]
        if effect.together:
            some = [own for own in effect.together if set(own) <= set(every)]
            subsets = [(own, 1.0 / len(some)) for own in some]
        elif effect.indivisible:
            subsets = [(every, 1.0)]
        else:
            subsets = _subsets(every, channels, refining)
        for names, share in subsets:
            touched: tuple[str, ...] = tuple(dict.fromkeys(c for n in names for c in channels[n]))
            stack.add(
                Candidate(
                    name=effect.slug,
                    index=np.array([index[n] for n in names]),
                    weight=weight * share / len(alike) / alike[frozenset(shape)],
                    physical=True,
                    channels=touched,
                    parameters=names,
                    shape=dict(shape),
                    present=all(units[n] == PRESENCE for n in names),
                    counted=all(units[n] == "samples" for n in names),
                )
            )


def _added(stack: Stack, rows: Rows, found: list[FloatArray]) -> Iterator[int]:
    """Add columns, each on the rows of turns and of the channels that feel it; return numbers."""
    columns = np.stack(found, axis=1)
    own = [rows.channel == c for c in range(len(CHANNELS))]
    felt = np.stack([columns[here].any(axis=0) for here in own], axis=1)
    number = np.empty(len(found), np.int64)
    for pattern in np.unique(felt, axis=0):
        mine = np.flatnonzero((felt == pattern).all(axis=1))
        touched = rows.touched(np.flatnonzero(pattern).tolist())
        number[mine] = stack.columns.add(columns[:, mine], touched)
    return iter(number.tolist())


def effect_columns(
    effect: Effect, rows: Rows, shape: Mapping[str, float], *, reference: bool
) -> dict[str, FloatArray]:
    """Return the row columns of an effect's parameters, in units of their typical sizes."""
    if not reference and all(p.unit == PRESENCE for p in effect.parameters):
        assert isinstance(effect, TransformEffect)
        if "both_cutoff" in shape and not _resolved(rows):
            # What samples do not resolve of the turns would be such a filter.
            return {}
        return whole_changes(effect, rows, shape)
    sizes = {p.name: p.typical for p in effect.parameters if reference or not p.reference_only}
    out = {}
    for name, plain in _plain_columns(effect, rows, shape).items():
        if name in sizes and f"{effect.slug}.{name}" not in rows.aligned:
            values = plain * sizes[name]
            if isinstance(effect, TransformEffect):
                # A delay or a filter changes nothing at rest; the grid thins rests, so that what
                # spills into them from a turn is not to scale.
                values[(rows.kind <= Kind.CONTRAST) & rows.is_rest[rows.segment]] = 0.0
                if "moment" in shape:
                    # Nor does a delay of whole turns: only the one it begins in does not close.
                    start, stop = rows.interval[rows.segment].T
                    inside = (shape["moment"] >= start) & (shape["moment"] <= stop)
                    values[(rows.kind >= Kind.ATTITUDE) & ~inside] = 0.0
            if "vibration" in effect.reads and rows.unresolved:
                # What trembling hands do between samples goes with how much they do.
                values[rows.kind >= Kind.ATTITUDE] = 0.0
            if np.abs(values).max() > 0:
                out[name] = values
    return out


def _resolved(rows: Rows) -> bool:
    if "resolved" not in rows.kept:
        rows.kept["resolved"] = are_resolved(rows)
    return bool(rows.kept["resolved"])


def _plain_columns(effect: Effect, rows: Rows, shape: Mapping[str, float]) -> dict[str, FloatArray]:
    """Return what one unit of each of an effect's parameters adds to the rows."""
    if effect.from_moment and rows.confined:
        if effect.slug not in rows.kept:
            rows.kept[effect.slug] = Onset(effect, rows)
        onset: Onset = rows.kept[effect.slug]
        return onset.columns(shape["moment"])
    gain = dict.fromkeys(CHANNELS, 1.0)
    if isinstance(effect, TransformEffect):
        # It acts on what the sensor puts out.
        scale = np.diagonal(rows.matrices, axis1=1, axis2=2)
        gain = dict(zip(CHANNELS, scale.ravel().tolist(), strict=True))
    return {
        n: rows.column({c: gain[c] * values for c, values in signals.items()})
        for n, signals in effect.columns(rows.state, shape).items()
    }


def candidate_columns(
    rows: Rows, candidate: Candidate, shape: Mapping[str, float], *, reference: bool
) -> FloatArray | None:
    """Return the columns of an effect's candidate at a shape; None if one shows nothing there."""
    found = effect_columns(get_effect(candidate.name), rows, shape, reference=reference)
    if not all(n in found for n in candidate.parameters):
        return None
    return np.stack([found[n] for n in candidate.parameters], axis=1)


def _subsets(
    names: tuple[str, ...], channels: Mapping[str, tuple[str, ...]], refining: tuple[str, ...]
) -> Iterator[tuple[tuple[str, ...], float]]:
    """Yield sets of parameters, and the share of each: one may be there, or all, or some.

    Some are those of one channel, and those that differ only in axis (a diagonal). Those that
    refine the others come with all of them only, and what few parameters explain as well is not
    given to many: over a narrow span of temperature a cube has any size.
    """
    every = names
    names = tuple(n for n in every if n not in refining)
    if not names:
        return
    if len(every) == 1:
        yield every, 1.0
        return
    groups = _alike(names, _kind)
    if len(every) > len(names):
        for name in names:
            yield (name,), 1.0 / 3.0 / len(names)
        nested = [*groups, names, every]
        for subset in nested:
            yield subset, 2.0 / 3.0 / len(subset) / sum(1.0 / len(s) for s in nested)
        return
    groups += _alike(names, channels.__getitem__)
    parts: list[list[tuple[str, ...]]] = [[(n,) for n in names], [names]]
    if groups:
        parts.append(groups)
    for part in parts:
        for subset in part:
            yield subset, 1.0 / len(parts) / len(part)


def _alike(names: tuple[str, ...], kind: Callable[[str], Hashable]) -> list[tuple[str, ...]]:
    """Return the names of each kind, where they are some of all."""
    kinds: dict[Hashable, list[str]] = {}
    for name in names:
        kinds.setdefault(kind(name), []).append(name)
    return [tuple(v) for v in kinds.values() if 1 < len(v) < len(names)]


def _kind(name: str) -> str:
    """Return the name without its axis, which a diagonal has twice; one of two axes is its own."""
    return re.sub(r"(?<![xyz])([xyz])\1?$", "", name)


def _shapes(effect: Effect, rows: Rows) -> Iterator[Mapping[str, float]]:
    """Yield the shapes that are tried: of optional sizes one at a time, of integers all."""
    integers = [item for item in effect.shape if item.spacing == "integer"]
    sizes = [item for item in effect.shape if item.spacing != "integer"]
    optional = [item for item in sizes if item.optional]
    fixed = [item for item in sizes if not item.optional]
    for choice in [[item] for item in optional] or [[]]:
        tried = [*fixed, *choice, *integers]
        grids = [shape_grid(item, rows, SHAPES) for item in tried]
        for values in product(*grids):
            shape = {item.name: float(v) for item, v in zip(tried, values, strict=True)}
            if effect.is_form(shape):
                yield shape


def shape_grid(item: ShapeParameter, rows: Rows, count: int) -> FloatArray:
    """Return the values of a shape parameter that are tried.

    A moment within the recording is tried in the middle of every rest and turn; a time constant
    on a logarithmic grid between its bounds, no longer than three times the recording.
    """
    time = rows.state.time
    start, stop = float(time[0]), float(time[-1])
    if item.spacing == "integer":
        return np.array(item.codes, np.float64)
    if item.is_moment:
        return np.asarray(rows.interval.mean(axis=1)[1:])
    low = item.low if item.low is not None else (stop - start) / 100
    high = item.high if item.high is not None else stop - start
    if item.unit == "s" and item.spacing == "log":
        high = max(min(high, 3 * (stop - start)), 1.01 * low)
    return (
        np.geomspace(low, high, count) if item.spacing == "log" else np.linspace(low, high, count)
    )


def forms(effect: Effect, shape: Mapping[str, float]) -> list[dict[str, float]]:
    """Return a shape with every value of its integers, its own first: another form, not a size."""
    out = [dict(shape)]
    for item in effect.shape:
        if item.spacing == "integer" and item.name in shape:
            others = [float(v) for v in item.codes if v != shape[item.name]]
            out += [{**known, item.name: v} for known in out for v in others]
    return [own for own in out if effect.is_form(own)]


def settles(candidate: Candidate) -> bool:
    """Whether it is what is over in a time of its own, as a warm-up."""
    return candidate.physical and not candidate.present and "tau" in candidate.shape


def is_step(candidate: Candidate) -> bool:
    """Whether it is a bias that steps: what acts from a moment on, and is no loss of samples."""
    effect = get_effect(candidate.name) if candidate.physical else None
    return effect is not None and effect.from_moment and not isinstance(effect, TransformEffect)


def around(rows: Rows, k: int) -> tuple[FloatArray, FloatArray]:
    """Return where segment `k` and those beside it begin, and where the next ones do.

    What was left out between two of them belongs to the first.
    """
    begin = rows.interval[:, 0]
    end = np.append(begin[1:], rows.interval[-1, 1])
    near = slice(max(k - 1, 0), k + 2)
    return begin[near], end[near]


def neighbours(
    effect: Effect, rows: Rows, shape: Mapping[str, float], *, closer: bool = False
) -> Iterator[dict[str, float]]:
    """Yield shapes around a chosen one, one parameter at a time, within the grid's spacing.

    Or, ``closer``, moments around one that these have found, within theirs.
    """
    for item in effect.shape:
        grid = shape_grid(item, rows, SHAPES)
        here = shape.get(item.name)
        if here is None or len(grid) < 2 or item.spacing == "integer":
            continue
        if item.is_moment:
            k = rows.segment_at(here)
            if isinstance(effect, TransformEffect):
                # What a delay leaves goes with the rate at its moment: a hand's tremor changes that
                # from sample to sample. A turn has rests beside it, a window has more of a turn.
                beside = int(bool(rows.aligned))
                near = np.abs(rows.point_segment - k) <= beside
                moments = rows.state.time[near & (not closer)]
            elif closer:
                space = np.ptp(rows.interval[k]) / (NEAR - 1)
                moments = np.linspace(here - space, here + space, NEAR)
            else:
                # Of what goes with the time since, the middle of a rest may say less than the end
                # of the turn before it.
                begin, end = around(rows, k)
                moments = np.linspace(begin, end, NEAR, endpoint=False).ravel()
            for value in moments:
                yield {**shape, item.name: float(value)}
            continue
        if closer:
            continue
        at = int(np.argmin(np.abs(grid - here)))
        low, high = grid[max(at - 1, 0)], grid[min(at + 1, len(grid) - 1)]
        space = np.geomspace if item.spacing == "log" else np.linspace
        for value in space(low, high, NEAR):
            yield {**shape, item.name: float(value)}
