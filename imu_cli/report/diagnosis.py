"""A diagnosis as a report: verdict, each finding with the plot that convinced, what is left."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from calib.effects.base import FORM, PRESENCE
from imu_cli.report.advice import next_step
from imu_cli.report.model import Block, Paragraph, Plot, Report, Series, Table
from imu_cli.report.units import people_unit, with_error
from imu_cli.report.words import (
    SEEN,
    VERDICTS,
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
    where,
)


def diagnosis_report(document: Mapping[str, Any]) -> Report:
    """Return the report of a diagnosis document (``imu-cal diagnose --json``)."""
    verdict, tone = headline(document), VERDICTS[document["verdict"]][1]
    findings = document["findings"]
    if findings:
        verdict += " Found: " + ", ".join(f.get("title", f["effect"]) for f in findings) + "."
    blocks: list[Block] = []
    if document.get("missing"):
        blocks.append(Paragraph("What is lacking", tuple(document["missing"])))
    if findings:
        blocks.append(_overview(findings))
    for number, finding in enumerate(findings, 1):
        blocks += _finding(number, finding)
    if document["unexplained"]:
        blocks.append(_unexplained(document["unexplained"], document.get("fit") or {}))
        if rivals := _rivals(document["unexplained"]):
            blocks.append(Paragraph("What else it may be", rivals))
        if (document.get("fit") or {}).get("residuals"):
            blocks.append(Paragraph("What to do next", _next_steps(document["unexplained"])))
        blocks += _where(document["unexplained"])
    for alias in document.get("aliases", ()):
        if alias["alike"]:
            blocks.append(Paragraph("What cannot be known", (alias_sentence(alias),)))
    if moved := moved_lines(document):
        blocks.append(Paragraph("What has moved since the calibration", tuple(moved)))
    said = notes(document)
    if said:
        blocks.append(Paragraph("What was done before", tuple(said)))
    fit = document.get("fit") or {}
    if fit.get("residuals"):
        blocks.append(_residuals(fit))
    if document.get("cannot_show"):
        rows = tuple(document["cannot_show"].items())
        blocks.append(Table("What this recording cannot show", ("effect", "what to record"), rows))
    return Report(
        title="Diagnosis",
        verdict=verdict,
        tone=tone,  # type: ignore[arg-type]
        facts=_facts(document),
        blocks=tuple(blocks),
        document=document,
        files=tuple((document.get("files") or {}).items()),
    )


def _facts(document: Mapping[str, Any]) -> tuple[tuple[str, str], ...]:
    recording = document.get("recording") or {}
    facts = [
        ("findings", str(len(document["findings"]))),
        ("unexplained", str(len(document["unexplained"]))),
    ]
    for key in ("poses", "turns"):
        if key in recording:
            facts.append((key, str(recording[key])))
    if "duration" in recording:
        facts.append(("recording", f"{float(recording['duration']):.0f} s"))
    return tuple(facts)


def _overview(findings: list[Mapping[str, Any]]) -> Table:
    rows = []
    for finding in findings:
        held = finding["held_out"]
        if held is None:
            gain = "-"
        else:
            unit, factor = people_unit(held["unit"])
            gain = (
                f"{held['before'] * factor:.3g} → {held['after'] * factor:.3g} {unit} "
                f"(floor {held['noise_floor'] * factor:.3g})"
            )
        rows.append(
            (
                finding["effect"],
                ", ".join(finding["channels"]),
                chance(finding["p_value"]),
                gain,
                ", ".join(r["effect"] for r in finding["rivals"]) or "-",
            )
        )
    return Table(
        "Findings",
        ("effect", "channels", "p", "held out, before → after", "rivals"),
        tuple(rows),
        (2,),
        "p is corrected for the number of looks. Held out: on poses and turns that the fit did not "
        "see.",
    )


def _finding(number: int, finding: Mapping[str, Any]) -> list[Block]:
    title = f"{number}. {finding.get('title', finding['effect'])}"
    sentences = [finding.get("sentence", ""), f"Where: {where(finding)}."]
    sentences += remarks(finding)
    if finding["absorbed_by"]:
        moved = [_absorbed(item) for item in finding["absorbed_by"]]
        sentences.append(f"Until now these parameters had taken it up: {', '.join(moved)}.")
    if finding["rivals"]:
        line = "; ".join(alternatives(finding["rivals"]))
        sentences.append(f"{line[0].upper()}{line[1:]}.")
    if finding["to_separate"]:
        sentences.append(finding["to_separate"])
    if finding["held_out"] is None and finding.get("held_out_reason"):
        sentences.append(f"Not checked on held-out data: {finding['held_out_reason']}.")
    rows = []
    for name, item in finding["parameters"].items():
        if item["unit"] not in (PRESENCE, FORM):  # channels and words say it
            rows.append((name, *with_error(item["value"], item["sigma"], item["unit"])))
    blocks: list[Block] = [Paragraph(title, tuple(s for s in sentences if s))]
    blocks.append(
        Table(
            f"Parameters of {finding['effect']}",
            ("parameter", "value", "standard error", "unit"),
            tuple(rows),
            (1, 2),
        )
    )
    if finding.get("evidence"):
        title = f"{number}. {finding['effect']}"
        blocks.append(
            _evidence(
                title,
                finding["evidence"],
                "Before (grey): under the model without the effect. After: with it.",
            )
        )
    return blocks


def _absorbed(item: Any) -> str:
    if isinstance(item, str):
        return item
    return f"{item['parameter']} by {shift_of(item)}"


def _evidence(
    title: str, evidence: Mapping[str, Any], note: str, shaded: Iterable[Sequence[float]] = ()
) -> Plot:
    unit, factor = people_unit(evidence["unit"])
    x_name, x_factor = people_unit(evidence["x_unit"])
    series = []
    for label in ("before", "after"):  # what is left is drawn over what was there
        for k, item in enumerate(evidence["series"]):
            x = np.asarray(item["x"], np.float64) * x_factor
            y = np.asarray(item[label], np.float64) * factor
            colour = 0 if label == "before" else k + 1
            series.append(Series(f"{item['channel']} {label}", x, y, colour=colour, shape=k))
    x_unit = f", {x_name}" if x_name else ""
    return Plot(
        f"{title}: residual against {evidence['follows']}",
        f"{evidence['follows']}{x_unit}",
        f"residual, {unit}",
        tuple(series),
        shaded=tuple((float(a) * x_factor, float(b) * x_factor) for a, b in shaded),
        note=note,
    )


def _unexplained(items: list[Mapping[str, Any]], fit: Mapping[str, Any]) -> Table:
    rows = tuple(
        (
            ", ".join(item["channels"]),
            _unbroken(spans(item["intervals"], "; ")),
            item["follows"].removeprefix(SEEN),
            much(item, fit).removeprefix("up to ") or "-",
            chance(item["p_value"]),
        )
        for item in items
    )
    return Table("Unexplained", ("channels", "when", "follows", "up to", "p"), rows, (4,))


def _unbroken(times: str) -> str:
    """Return intervals that a narrow cell breaks between, and not within."""
    return times.replace(" to ", "\u00a0to\u00a0").replace(" s", "\u00a0s")


def _rivals(items: list[Mapping[str, Any]]) -> tuple[str, ...]:
    return tuple(
        f"{', '.join(item['channels'])}; {item['follows'].removeprefix(SEEN)}: {'; '.join(lines)}."
        for item in items
        if (lines := alternatives(item.get("rivals", ())))
    )


def _next_steps(items: list[Mapping[str, Any]]) -> tuple[str, ...]:
    steps: dict[str, list[str]] = {}
    for item in items:
        steps.setdefault(next_step(item), []).extend(item["channels"])
    return tuple(f"{', '.join(dict.fromkeys(on))}: {step}." for step, on in steps.items())


def _where(items: list[Mapping[str, Any]]) -> list[Block]:
    """Return a plot of each item that rows show."""
    out: list[Block] = []
    for item in items:
        evidence = item.get("evidence")
        if evidence is None:
            continue
        in_time = evidence["follows"] == "time"
        shaded = item["intervals"] if in_time else ()
        note = (
            "Before (grey): what is unexplained is in it. After: with what it looks like taken off."
        )
        title = f"Unexplained on {', '.join(item['channels'])}"
        out.append(_evidence(title, evidence, note, shaded))
    return out


def _residuals(fit: Mapping[str, Any]) -> Table:
    rows = []
    for item in fit["residuals"]:
        unit, factor = people_unit(item["unit"])
        numbers = (f"{item[key] * factor:.3g}" for key in ("before", "after", "noise_floor"))
        rows.append((item["rows"], *numbers, unit))
    return Table(
        "Residuals before and after",
        ("rows", "before", "after", "noise floor", "unit"),
        tuple(rows),
        (1, 2, 3),
        likelihood(fit),
    )
