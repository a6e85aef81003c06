"""Every command in README and docs runs; what needs a device is parsed."""

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from imu_cli.app import app

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs/pages").glob("*.md"))]
BLOCK = re.compile(r"^```(?P<tag>[^\n]*)\n(?P<body>.*?)^```", re.MULTILINE | re.DOTALL)
OPERATORS = set("();<>|&")


def commands(page: Path, tag: str) -> list[str]:
    found = []
    for block in BLOCK.finditer(page.read_text(encoding="utf-8")):
        if block["tag"].strip() == tag:
            found += [ln[2:] for ln in block["body"].splitlines() if ln.startswith("$ ")]
    return found


def files(page: Path, folder: Path) -> None:
    """Give a page what its commands read: the fixtures, and the TOML that it shows."""
    shutil.copy(ROOT / "fixtures/bench.csv", folder / "bench.csv")
    for block in BLOCK.finditer(page.read_text(encoding="utf-8")):
        if block["tag"].strip() == "toml" and "[station]" in block["body"]:
            (folder / "station.toml").write_text(block["body"], encoding="utf-8")
    tool = folder / "bin" / "imu-cal"
    tool.parent.mkdir()
    tool.write_text(f'#!/bin/sh\nexec {shlex.quote(sys.executable)} -m imu_cli "$@"\n')
    tool.chmod(0o755)


def run(line: str, folder: Path) -> tuple[int, str, str]:
    """Return exit code and both outputs of a command; only what needs a shell gets a process."""
    words = shlex.shlex(line, posix=True, punctuation_chars=True)
    words.whitespace_split = True
    tool, *arguments = words
    if tool == "imu-cal" and not any(set(word) <= OPERATORS for word in arguments):
        result = CliRunner().invoke(app, arguments, catch_exceptions=False)
        return result.exit_code, result.stdout, result.stderr
    environment = os.environ | {
        "PYTHONPATH": str(ROOT),
        "PATH": f"{folder / 'bin'}{os.pathsep}{os.environ['PATH']}",
    }
    done = subprocess.run(
        ["sh", "-c", line],
        env=environment,
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )
    return done.returncode, done.stdout, done.stderr


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
@pytest.mark.long
def test_the_commands_of_a_page_run(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lines = commands(page, "console")
    if not lines:
        pytest.skip("the page has no commands")
    files(page, tmp_path)
    monkeypatch.chdir(tmp_path)
    for line in lines:
        if line.startswith("make "):
            target = line.split()[1]
            assert re.search(rf"^{target}:", (ROOT / "Makefile").read_text(), re.MULTILINE)
            continue
        if line.startswith(("git ", "pip ")):
            continue  # how to get it: the tests run in what it got
        code, out, err = run(line, tmp_path)
        assert code == 0, f"{line}\n{out[-2000:]}\n{err[-2000:]}"
        assert "Traceback" not in err


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_the_commands_for_a_device_are_parsed(page: Path) -> None:
    from typer.main import get_command

    group = get_command(app)
    context = group.make_context("imu-cal", [], resilient_parsing=True)
    for line in commands(page, "console hardware"):
        tool, verb, *arguments = shlex.split(line)
        assert tool == "imu-cal"
        command = group.get_command(context, verb)
        assert command is not None, line
        with command.make_context(verb, arguments, parent=context):
            pass


@pytest.mark.long
def test_the_documentation_builds() -> None:
    pytest.importorskip("mkdocs", reason="needs mkdocs-material (extra docs)")
    done = subprocess.run(
        [sys.executable, str(ROOT / "docs/build.py")],
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_every_figure_that_a_page_shows_is_there() -> None:
    for page in PAGES:
        for link in re.findall(r"!\[[^\]]*\]\(([^)]+)\)", page.read_text(encoding="utf-8")):
            assert (page.parent / link).is_file(), f"{page.name} shows {link}"
