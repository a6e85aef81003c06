"""Comparisons and verifications as a person, or a program, reads them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from calib.checks import Check
from calib.compare import Comparison, Difference
from calib.verify import Verification
from imu_cli.calibration_view import NUMBER, everyday, plus_minus, residual_text
from imu_cli.output import styled

if TYPE_CHECKING:
    from rich.table import Table
    from rich.text import Text


SCORE = 7
"""Characters of a score: a narrow window takes none of them away."""


def difference_table(differences: tuple[Difference, ...], changed: tuple[Difference, ...]) -> Table:
    """Return a table of differences: second less first, with the score in standard errors."""
    from rich.table import Table

    table = Table(box=None, pad_edge=False, collapse_padding=True, header_style="bold")
    table.add_column("parameter", overflow="fold")
    table.add_column("difference ± std error", justify="right", min_width=NUMBER)
    table.add_column("", overflow="fold")
    table.add_column("std errors", justify="right", min_width=SCORE)
    table.add_column("", overflow="fold")
    for item in differences:
        factor, unit = everyday(item.name)
        mark: str | Text = styled(("changed", "red")) if item in changed else ""
        table.add_row(
            item.name,
            plus_minus(factor * item.difference, factor * item.sigma),
            unit,
            f"{item.score:+.1f}",
            mark,
        )
    return table


def comparison_line(comparison: Comparison) -> Text:
    """Return the answer in one line; of what one alone determines it does not say anything."""
    alone = comparison.only_first or comparison.only_second
    shared = " in what both have" if alone else ""
    return styled(
        f"all {len(comparison.differences)} together: p = {comparison.p_value:.2g}: ",
        (f"the same{shared}", "green") if comparison.same else (f"different{shared}", "red"),
    )


def check_lines(verification: Verification) -> list[str | Text]:
    """Return one line for each check: what is left, what was expected."""
    lines: list[str | Text] = []
    for check in verification.checks:
        failed = check in verification.failed
        verdict: str | tuple[str, str] = ("NOT RIGHT", "red") if failed else "right"
        seen, expected = _size(check.rms, check.unit), _size(check.expected, check.unit)
        lines.append(
            styled(
                f"{check.name:<9}{check.count:>4} {_plural(check)}: {seen} rms, "
                f"expected {expected}: ",
                verdict,
                f" (p = {check.p_value:.2g})",
            )
        )
        if failed:
            low, high = check.worst
            lines.append(f"             the most at {low:.2f} to {high:.2f} s")
    lines += [
        styled(f"{item.name:<9}", ("not tested", "yellow"), f": {item.reason}")
        for item in verification.not_tested
    ]
    return lines


def answer_line(verification: Verification) -> Text:
    """Return the answer in one line; of what was not tested it does not say that it is right."""
    if not verification.right:
        return styled(
            ("the calibration is NOT right for this device today", "red"), ": calibrate again"
        )
    if not verification.not_tested:
        return styled(("the calibration is right for this recording", "green"))
    tested = " and ".join(check.name for check in verification.checks)
    left = " and ".join(item.name for item in verification.not_tested)
    return styled(
        (f"the calibration is right for this recording as to {tested}", "green"),
        f"; {left}: not tested",
    )


def comparison_document(comparison: Comparison) -> dict[str, Any]:
    """Return a comparison for ``--json``."""
    changed = comparison.changed
    return {
        "same": comparison.same,
        "p_value": comparison.p_value,
        "chi_square": comparison.chi_square,
        "rank": comparison.rank,
        "significance": comparison.significance,
        "identity_mismatch": comparison.identity or None,
        "parameters": {
            item.name: {
                "first": item.first,
                "second": item.second,
                "difference": item.difference,
                "sigma": item.sigma,
                "allowance": item.allowance,
                "score": item.score,
                "degrees_of_freedom": item.degrees_of_freedom,
                "p_value": item.p_value,
                "changed": item in changed,
                "unit": item.unit,
            }
            for item in comparison.differences
        },
        "only_first": list(comparison.only_first),
        "only_second": list(comparison.only_second),
    }


def verification_document(verification: Verification) -> dict[str, Any]:
    """Return a verification for ``--json``."""
    comparison = verification.comparison
    return {
        "format": "imu-cal/verification",
        "version": 1,
        "right": verification.right,
        "significance": verification.significance,
        "identity_mismatch": verification.identity or None,
        "remarks": list(verification.remarks),
        "checks": [
            {
                "name": check.name,
                "what": check.what,
                "right": check not in verification.failed,
                "count": check.count,
                "rms": check.rms,
                "expected": check.expected,
                "unit": check.unit,
                "chi_square": check.chi_square,
                "degrees_of_freedom": check.degrees_of_freedom,
                "p_value": check.p_value,
                "worst": list(check.worst),
            }
            for check in verification.checks
        ],
        "not_tested": [
            {"name": item.name, "reason": item.reason} for item in verification.not_tested
        ],
        "comparison": None if comparison is None else comparison_document(comparison),
    }


def _plural(check: Check) -> str:
    noun = "turn" if check.name == "turns" else "pose"
    return noun if check.count == 1 else f"{noun}s"


def _size(value: float, unit: str) -> str:
    if unit == "rad/s":
        return f"{np.degrees(value):.4f}°/s"
    return residual_text(value, unit).partition(" (")[0]
