"""Build the documentation: pages written by hand, and pages made from the code.

python docs/build.py          # into site/
python docs/build.py --pages  # only the Markdown, into build/docs/
"""

from __future__ import annotations

import argparse
import importlib
import os
import shutil
import subprocess
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
PAGES = ROOT / "docs" / "pages"
OUT = ROOT / "build" / "docs"


def command_pages() -> Iterator[tuple[str, str]]:
    """Yield a page for each verb: its help, as the terminal prints it."""
    from typer.main import get_command

    from imu_cli.app import app

    group: Any = get_command(app)
    context = group.make_context("imu-cal", [], resilient_parsing=True)
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        inner = command.make_context(name, [], parent=context, resilient_parsing=True)
        yield name, f"# imu-cal {name}\n\n```text\n{command.get_help(inner)}\n```\n"


def effect_pages() -> Iterator[tuple[str, str]]:
    """Yield a page for each effect of the catalogue."""
    from calib.effects import effects

    for slug, effect in effects().items():
        rows = "\n".join(
            f"| `{p.name}` | {p.unit} | {p.typical:.3g} | {', '.join(p.channels)} |"
            for p in effect.parameters
        )
        shapes = "\n".join(
            f"| `{p.name}` | {p.unit} | searched from {_or_span(p.low)} to {_or_span(p.high)} | |"
            for p in effect.shape
        )
        yield (
            slug,
            f"# {slug}\n\n{effect.title[:1].upper()}{effect.title[1:]}. "
            f"{KINDS[effect.kind]}\n\n> {effect.sentence}\n\n"
            f"**Equation:** `{effect.equation}`\n\n"
            f"| parameter | unit | typical size | channels |\n|---|---|---|---|\n"
            f"{rows}\n{shapes}\n\n"
            f"**To identify it:** {effect.needs}.\n\n**Source:** {effect.source}.\n",
        )


KINDS = {
    "sensor": "A term of the sensor: it becomes part of the calibration.",
    "event": "An event of one recording: it is reported, and not part of the calibration.",
    "setup": "A property of the fixture or of the reference, not of the sensor.",
}


def _or_span(bound: float | None) -> str:
    return "the recording's span" if bound is None else f"{bound:g}"


def registry_pages(package: str, attribute: str) -> Iterator[tuple[str, str]]:
    """Yield a page for each module of a registry: its docstring, which states the facts."""
    import pkgutil

    folder = importlib.import_module(package)
    for info in pkgutil.iter_modules(folder.__path__):
        module = importlib.import_module(f"{package}.{info.name}")
        if hasattr(module, attribute):
            yield info.name, f"# {info.name}\n\n```text\n{(module.__doc__ or '').strip()}\n```\n"


SECTIONS = {
    "commands": ("Commands", command_pages),
    "effects": ("Effects", effect_pages),
    "chips": ("Chips", lambda: registry_pages("drivers.chips", "CHIP")),
    "dialects": ("Serial dialects", lambda: registry_pages("drivers.dialects", "DIALECT")),
}


SECTIONS_OF_README = {
    "tutorial": "Five minutes",
    "methods": "Which method",
    "numbers": "What the numbers mean",
    "figures": "What it reaches",
    "comparison": "Beside other tools",
}


def single_pages() -> Iterator[tuple[str, str]]:
    """Yield the pages that say what README or code say once: tutorial, conventions, exit codes."""
    import calib
    from calib import errors

    parts = (ROOT / "README.md").read_text(encoding="utf-8").split("\n## ")
    readme = {title: body for title, _, body in (part.partition("\n") for part in parts)}
    for name, title in SECTIONS_OF_README.items():
        body = (
            readme[title].replace("docs/pages/", "").replace("(#what-it-reaches)", "(figures.md)")
        )
        yield name, f"# {title}\n{body}"
    yield "conventions", f"# Conventions\n\n```text\n{(calib.__doc__ or '').strip()}\n```\n"
    yield "exit-codes", f"# Exit codes\n\n```text\n{(errors.__doc__ or '').strip()}\n```\n"


def write_section(folder: str, title: str, pages: Iterable[tuple[str, str]]) -> None:
    """Write the pages of one section and an index that links to each."""
    target = OUT / folder
    target.mkdir(parents=True, exist_ok=True)
    lines = [f"# {title}", ""]
    for name, text in pages:
        (target / f"{name}.md").write_text(text, encoding="utf-8")
        lines.append(f"- [`{name}`]({name}.md)")
    (target / "index.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


def main() -> int:
    """Write the pages; unless --pages, let mkdocs check them and build the site."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pages", action="store_true", help="stop after the Markdown")
    arguments = parser.parse_args()
    shutil.rmtree(OUT, ignore_errors=True)
    shutil.copytree(PAGES, OUT)
    for name, text in single_pages():
        (OUT / f"{name}.md").write_text(text, encoding="utf-8")
    for folder, (title, pages) in SECTIONS.items():
        write_section(folder, title, pages())
    if arguments.pages:
        return 0
    return subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--quiet", "-f", str(ROOT / "docs/mkdocs.yml")],
        check=False,
        env=os.environ | {"NO_MKDOCS_2_WARNING": "1"},
    ).returncode


if __name__ == "__main__":
    sys.exit(main())
