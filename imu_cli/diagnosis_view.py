"""A diagnosis as a person reads it on a screen."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from calib.effects.base import FORM, PRESENCE
from imu_cli.output import styled
from imu_cli.report.advice import next_step
from imu_cli.report.units import people_unit, said
from imu_cli.report.words import (
    alias_sentence,
    alternatives,
    chance,
    headline,
    likelihood,
    moved_lines,
    much,
    notes,
    remarks,
    shift_of,
    spans,
    what,
    where,
)

if TYPE_CHECKING:
    from rich.table import Table
    from rich.text import Text

ABSORBED = 4
"""So many of the parameters that had absorbed an effect are said; the document has all."""

NUMBER = 7
"""Characters of a number in a table: a narrow window takes none of them away."""


def diagnosis_lines(document: Mapping[str, Any]) -> Iterator[str | Text | Table]:
    """Yield what a diagnosis document says (``imu-cal diagnose --json``), line by line."""
    yield styled((headline(document), "bold"))
    for number, finding in enumerate(document["findings"], 1):
        yield ""
        yield styled((f"{number}. {finding['title']}", "bold"), f" ({finding['effect']})")
        yield from (f"   {line}" for line in _finding(finding))
    for left in document["unexplained"]:
        said_of = [", ".join(left["channels"]), spans(left["intervals"]), what(left["follows"])]
        words = "; ".join(said_of)
        if size := much(left, document["fit"]):
            words += f", {size}"
        yield ""
        yield styled(("Unexplained", "bold"), f": {words} (p {_equal(left['p_value'])}).")
        yield from (f"  {line}" for line in alternatives(left["rivals"]))
        if document["fit"]["residuals"]:  # what ends a diagnosis says itself what it needs
            yield f"  next: {next_step(left)}"
    for alias in document["aliases"]:
        if alias["alike"]:
            yield ""
            yield styled(("Cannot be known", "bold"), f": {alias_sentence(alias)}")
    if moved := moved_lines(document):
        yield ""
        yield styled(("Moved since the calibration", "bold"), "; calibrate again:")
        yield from (f"   {line}" for line in moved)
    # Nothing was fitted to what must be mended first.
    if residuals := document["fit"]["residuals"]:
        explained = bool(document["findings"] or document["unexplained"])
        yield ""
        yield _residuals(residuals, explained=explained)
        if explained and (line := likelihood(document["fit"])):
            yield f" {line}"
    for note in notes(document):
        yield ""
        yield note


def _finding(finding: Mapping[str, Any]) -> Iterator[str]:
    yield finding["sentence"]
    yield f"Where: {where(finding)}."
    yield f"How sure: p {_equal(finding['p_value'])}, all looks counted."
    for name, item in finding["parameters"].items():
        if item["unit"] not in (PRESENCE, FORM):  # channels and words say it
            yield f"{name} = {said(item['value'], item['sigma'], item['unit'])}"
    yield from remarks(finding)
    for item in finding["absorbed_by"][:ABSORBED]:
        yield (
            f"{item['parameter']} was off by {shift_of(item)} to take it up "
            f"({item['standard_errors']:.1f} standard errors)."
        )
    held = finding["held_out"]
    if held is not None:
        gain = _in_unit(held["unit"], held["before"], held["after"])
        floor = _in_unit(held["unit"], held["noise_floor"])
        yield (
            f"On held-out blocks, {held['rows']}: {gain} (noise floor {floor}); "
            f"log-likelihood {held['log_likelihood_gain']:+.1f}."
        )
    elif finding["held_out_reason"]:
        yield f"Not checked on held-out data: {finding['held_out_reason']}."
    for line in alternatives(finding["rivals"]):
        yield f"{line[0].upper()}{line[1:]}."
    if finding["to_separate"]:
        yield finding["to_separate"]


def _equal(p_value: float) -> str:
    text = chance(p_value)
    return text if text.startswith("<") else f"= {text}"


def _in_unit(unit: str, *values: float) -> str:
    """Return values in the unit that people use, one after the other."""
    name, factor = people_unit(unit)
    return " -> ".join(f"{value * factor:.3g}" for value in values) + f" {name}"


def _residuals(residuals: Sequence[Mapping[str, Any]], *, explained: bool) -> Table:
    """Return what is left beside the noise floor; before and after, if anything was explained."""
    from rich.table import Table

    table = Table("residual", box=None)
    columns = {"before": "before", "after": "after"} if explained else {"left": "before"}
    columns["noise floor"] = "noise_floor"
    for name in columns:
        table.add_column(name, justify="right", min_width=NUMBER)
    for item in residuals:
        unit, factor = people_unit(item["unit"])
        values = (item[key] * factor for key in columns.values())
        table.add_row(f"{item['rows']}, {unit}", *(f"{value:.3g}" for value in values))
    return table
