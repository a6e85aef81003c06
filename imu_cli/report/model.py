"""What a report consists of, independent of how it is drawn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

from calib.types import FloatArray


@dataclass(frozen=True, eq=False)
class Series:
    """Points (n,) of one colour; ``text`` is what a hover shows beside the numbers.

    ``colour`` and ``shape`` count through those of the page; the colour is that of its place if
    None.
    """

    name: str
    x: FloatArray
    y: FloatArray
    kind: Literal["line", "points", "bars"] = "points"
    text: Sequence[str] = ()
    colour: int | None = None
    shape: int = 0


@dataclass(frozen=True, eq=False)
class Plot:
    """Series over a common x; ``shaded`` are x intervals to mark, ``note`` the line below."""

    title: str
    x_label: str
    y_label: str
    series: tuple[Series, ...]
    shaded: tuple[tuple[float, float], ...] = ()
    note: str = ""


@dataclass(frozen=True, eq=False)
class Sphere:
    """Unit vectors (n, 3) on a sphere, each with its label."""

    title: str
    points: FloatArray
    text: Sequence[str]
    note: str = ""


@dataclass(frozen=True, eq=False)
class HeatMap:
    """A square matrix (n, n) between -1 and 1."""

    title: str
    labels: Sequence[str]
    values: FloatArray
    note: str = ""


Chart = Plot | Sphere | HeatMap


@dataclass(frozen=True)
class Table:
    """Rows of text; ``numbers`` tells which columns are aligned to the right."""

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    numbers: tuple[int, ...] = ()
    note: str = ""


@dataclass(frozen=True)
class Paragraph:
    """A heading with sentences below it."""

    title: str
    sentences: tuple[str, ...]


Block = Table | Paragraph | Chart


@dataclass(frozen=True)
class Report:
    """A report: the verdict comes first.

    ``tone`` colours the verdict: ``good``, ``partial`` or ``bad``. ``facts`` are the headline
    numbers, ``files`` the names of what it was made from, ``document`` its JSON.
    """

    title: str
    verdict: str
    tone: Literal["good", "partial", "bad"]
    facts: tuple[tuple[str, str], ...]
    blocks: tuple[Block, ...]
    certificate: tuple[tuple[str, str], ...] = ()
    document: object = field(default=None)
    files: tuple[tuple[str, str], ...] = ()
