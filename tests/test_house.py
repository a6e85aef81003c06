"""The house rules that a machine can hold."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
ALLOWED = {
    "calib": {"calib", "numpy", "scipy"},
    "drivers": {"calib", "drivers"},
    "imu_cli": {"calib", "drivers", "imu_cli"},
}
OURS = {"calib", "drivers", "imu_cli"}
LAYERS = ("rows", "noise", "twin", "findings", "hypotheses", "search", "samples", "reference")
MODULES = [p for package in ALLOWED for p in sorted((ROOT / package).rglob("*.py"))]


def imported(path: Path) -> set[str]:
    names = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: imports are absolute"
            names.add((node.module or "").split(".")[0])
    return names


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(ROOT)))
def test_imports_run_one_way(path: Path) -> None:
    package = path.relative_to(ROOT).parts[0]
    names = imported(path)
    assert names & OURS <= ALLOWED[package]
    if package == "calib":
        assert names <= ALLOWED["calib"] | set(sys.stdlib_module_names)


@pytest.mark.parametrize("layer", LAYERS)
def test_layers_of_the_diagnosis_import_downwards(layer: str) -> None:
    above = LAYERS[LAYERS.index(layer) + 1 :]
    paths = sorted((ROOT / "calib" / "mismatch" / layer).glob("*.py"))
    assert paths
    for path in paths:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom):
                assert not (node.module or "").startswith(
                    tuple(f"calib.mismatch.{name}" for name in above)
                ), f"{path} imports from above it"


def test_a_diagnosis_starts_without_what_only_few_need() -> None:
    """Each of these is a tenth of a second to half a second, and tens of megabytes."""
    few = ("scipy.interpolate", "scipy.optimize", "scipy.signal", "scipy.spatial", "scipy.stats")
    code = f"import sys, calib.mismatch; print([m for m in {few} if m in sys.modules])"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT
    )
    assert done.stdout.strip() == "[]"


def test_only_output_prints() -> None:
    for path in MODULES:
        calls = [
            node
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
            if isinstance(node, ast.Call)
            and isinstance(node.func, ast.Name)
            and node.func.id == "print"
        ]
        assert not calls, f"{path}: print() belongs in imu_cli.output"
