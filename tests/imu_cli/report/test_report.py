"""Reports say what their documents say, in a browser and on paper."""

import json
import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from calib.calibrate import calibrate
from calib.calibration import Calibration
from calib.document import to_document
from calib.model import SensorModel, Triad
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import CONSUMER
from calib.uncertainty import uncertainty_budget
from drivers.calibration_file import save_calibration
from drivers.formats import write_recording
from imu_cli.report.contents import calibration_report
from imu_cli.report.diagnosis import diagnosis_report
from imu_cli.report.model import Plot
from imu_cli.report.page import COLOURS, draw, render_page
from imu_cli.report.picture import write_picture
from imu_cli.report.source import load_report
from imu_cli.report.units import people_unit, with_error

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
WATCH = """<script>
const note = (what) => { document.documentElement.dataset.errors = what; };
window.addEventListener("error", (event) => note(event.message));
window.addEventListener("unhandledrejection", (event) => note(String(event.reason)));
const error = console.error;
console.error = (...what) => { note(what.join(" ")); error(...what); };
</script>"""
DIAGNOSIS = {
    "format": "imu-cal/diagnosis",
    "version": 1,
    "verdict": "partly_explained",
    "findings": [
        {
            "effect": "gyro_g_sensitivity",
            "title": "gyro g-sensitivity",
            "channels": ["gyro.x"],
            "intervals": [[0.0, 60.0]],
            "regime": "follows pose",
            "parameters": {"gxx": {"value": 1e-4, "sigma": 1e-5, "unit": "(rad/s)/(m/s²)"}},
            "p_value": 1e-6,
            "absorbed_by": ["gyro.bias.x"],
            "held_out": {"before": 1e-3, "after": 5e-4, "noise_floor": 4e-4, "unit": "rad/s"},
            "rivals": [{"effect": "earth_rate", "odds": 0.1}],
            "to_separate": "turn the table by 90° and repeat.",
            "sentence": "The gyro senses <b>specific force</b>.",
            "evidence": {
                "follows": "specific force x",
                "x_unit": "m/s²",
                "unit": "rad/s",
                "series": [
                    {
                        "channel": "gyro.x",
                        "x": [-9.8, 9.8],
                        "before": [-1e-3, 1e-3],
                        "after": [0, 0],
                    }
                ],
            },
        }
    ],
    "unexplained": [
        {"channels": ["accel.y"], "intervals": [[3.0, 9.0]], "follows": "time", "p_value": 1e-4}
    ],
}


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    rng = np.random.default_rng(3)
    lower = np.array([[0, 0, 0], [0.01, 0, 0], [0.02, 0.03, 0]])
    model = SensorModel(
        Triad(np.array([0.3, -0.2, 0.1]), np.array([0.01, -0.02, 0.015]), lower),
        Triad(np.array([0.02, -0.01, 0.03]), np.array([0.01, -0.02, 0.03]), np.zeros((3, 3))),
    )
    motion = bench_protocol(rng, poses=20)
    recording = simulate(motion, model, CONSUMER, rng=rng, rate=100.0)
    return calibrate(recording, gravity=9.80665)


class Cells(HTMLParser):
    """Collect the rows of every table."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.rows: list[list[str]] = []
        self.inside = False
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: object) -> None:
        if tag == "tr":
            self.rows.append([])
        if tag == "td":
            self.rows[-1].append("")
            self.inside = True

    def handle_endtag(self, tag: str) -> None:
        if tag == "td":
            self.inside = False

    def handle_data(self, data: str) -> None:
        if self.inside:
            self.rows[-1][-1] += data.strip()


def test_the_numbers_on_the_page_are_those_of_the_document(calibration: Calibration) -> None:
    page = render_page(calibration_report(calibration))
    embedded = re.search(r'<script type="application/json" id="document">(.*?)</script>', page)
    assert embedded is not None
    document = json.loads(embedded[1])
    assert document == to_document(calibration)
    rows = {row[0]: row[1:] for row in reversed(Cells(page).rows) if row}
    for name, sigma in calibration.sigmas.items():
        item = document["parameters"][name]
        value, error, unit = rows[name][:3]
        factor = people_unit(item["unit"])[1]
        assert unit == people_unit(item["unit"])[0]
        assert float(error) == pytest.approx(sigma * factor, rel=0.06)
        assert float(value) == pytest.approx(item["value"] * factor, abs=0.06 * sigma * factor)


def test_the_page_asks_for_nothing_from_a_network(calibration: Calibration) -> None:
    page = render_page(calibration_report(calibration))
    outside = re.sub(r"<script>.*?</script>", "", page, flags=re.DOTALL)
    assert not re.search(r'(src|href)="(?!data:)', outside)


def test_text_of_a_document_is_escaped() -> None:
    page = render_page(diagnosis_report(DIAGNOSIS))
    assert "Or: earth_rate, 0.1 times as probable." in page
    assert "<b>specific force</b>" not in page.split('id="document"')[0]
    assert "residual against specific force x" in page


def test_the_page_names_the_files_in_its_head() -> None:
    files = {"recording": "walk<1>.csv", "calibration": "bench.cal.json"}
    page = render_page(diagnosis_report({**DIAGNOSIS, "files": files}))
    head = re.search(r"<header>.*?</header>", page, flags=re.DOTALL)
    assert head is not None
    assert "recording: <b>walk&lt;1&gt;.csv</b>" in head[0]
    assert "calibration: <b>bench.cal.json</b>" in head[0]
    assert "<title>Diagnosis of walk&lt;1&gt;.csv · imu-cal</title>" in page


def test_before_is_grey_in_all_channels_and_after_has_a_colour_for_each() -> None:
    finding = DIAGNOSIS["findings"][0]  # type: ignore[index]
    one = finding["evidence"]["series"][0]
    several = [{**one, "channel": f"{t}.{a}"} for t in ("accel", "gyro") for a in "xyz"]
    evidence = {**finding["evidence"], "series": several}
    report = diagnosis_report({**DIAGNOSIS, "findings": [{**finding, "evidence": evidence}]})
    plot = next(block for block in report.blocks if isinstance(block, Plot))
    drawn = {trace.name: trace.marker for trace in draw(plot).data}
    assert len(drawn) == 12
    before = [drawn[f"{item['channel']} before"] for item in several]
    after = [drawn[f"{item['channel']} after"] for item in several]
    assert {marker.color for marker in before} == {COLOURS[0]}
    assert len({marker.color for marker in after} - {COLOURS[0]}) == 6
    assert [m.symbol for m in before] == [m.symbol for m in after]
    assert len({marker.symbol for marker in before}) == 6


def test_what_is_unexplained_is_drawn_with_its_window_shaded() -> None:
    item = DIAGNOSIS["unexplained"][0]  # type: ignore[index]
    assert not any(
        isinstance(b, Plot) for b in diagnosis_report({**DIAGNOSIS, "findings": []}).blocks
    )
    series = [{"channel": "accel.y", "x": [1.0, 5.0], "before": [0.0, 1.0], "after": [0.0, 0.1]}]
    evidence = {"follows": "time", "x_unit": "s", "unit": "m/s²", "series": series}

    def plot(**changes: object) -> Plot:
        left = {**item, "evidence": {**evidence, **changes}}
        report = diagnosis_report({**DIAGNOSIS, "findings": [], "unexplained": [left]})
        (drawn,) = (block for block in report.blocks if isinstance(block, Plot))
        return drawn

    assert plot().shaded == ((3.0, 9.0),)
    assert "accel.y" in plot().title
    assert len(draw(plot()).layout.shapes) == 1
    assert plot(follows="temperature", x_unit="°C").shaded == ()


def test_what_is_unexplained_has_a_next_step_and_what_else_it_may_be() -> None:
    left = {
        **DIAGNOSIS["unexplained"][0],  # type: ignore[index]
        "follows": "speed of rotation",
        "rivals": [{"effect": "accel_settling", "odds": 29.4}],
    }
    residuals = [
        {"rows": "accel at rest", "unit": "m/s²", "before": 2.0, "after": 1.0, "noise_floor": 1.0}
    ]
    shown = {"quantization": "few distinct values at rest"}
    page = render_page(
        diagnosis_report(
            {
                **DIAGNOSIS,
                "unexplained": [left],
                "cannot_show": shown,
                "fit": {"residuals": residuals},
            }
        )
    )
    assert "or, more probable: accel_settling, 29 times as probable." in page
    assert "accel.y: record slow and fast turns about every axis." in page
    assert "3.0\u00a0to\u00a09.0\u00a0s" in page
    assert "<th>what to record</th>" in page


def test_names_in_cells_break_after_underscores_and_charts_are_printed() -> None:
    """Words of a narrow cell broke anywhere, and paper had no charts."""
    page = render_page(diagnosis_report(DIAGNOSIS))
    assert "<td>gyro_<wbr>g_<wbr>sensitivity</td>" in page
    style = page.partition("<style>")[2].partition("</style>")[0]
    assert ".chart { display: none" not in style
    assert "overflow-wrap: anywhere" not in style.partition("th, td")[2].partition("}")[0]
    assert 'addEventListener("beforeprint"' in page


def test_no_legend_is_under_the_tool_bar() -> None:
    finding = DIAGNOSIS["findings"][0]  # type: ignore[index]
    report = diagnosis_report({**DIAGNOSIS, "findings": [finding]})
    plot = next(block for block in report.blocks if isinstance(block, Plot))
    legend = draw(plot).layout.legend
    assert (legend.y < 0, legend.yanchor) == (True, "top")


def test_the_budget_is_the_root_of_squares(calibration: Calibration) -> None:
    for item in uncertainty_budget(calibration):
        parts = [item.type_a, *item.type_b.values()]
        assert item.combined == pytest.approx(np.sqrt(np.sum(np.square(parts))))
        assert item.expanded == pytest.approx(2 * item.combined)


@pytest.mark.parametrize(
    ("value", "error", "unit", "expected"),
    [
        (0.1, 0.01, "m/s²", ("10.2", "1.0", "mg")),
        (0.012, 0.00031, "rad", ("0.688", "0.018", "°")),
        (1e-4, 2e-6, "(m/s²)/(m/s²)²", ("0.981", "0.020", "mg/g²")),
        (1e-3, 1e-5, "(rad/s)/(K/s)", ("0.05730", "0.00057", "dps/(K/s)")),
        (0.01, None, "1", ("1", "-", "%")),
        (123.4, 12.0, "K", ("123", "12", "K")),
    ],
)
def test_numbers_are_written_to_their_errors_second_digit(
    value: float, error: float | None, unit: str, expected: tuple[str, str, str]
) -> None:
    assert with_error(value, error, unit) == expected


def test_pictures_are_drawn(calibration: Calibration, tmp_path: Path) -> None:
    write_picture(calibration_report(calibration), tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    write_picture(diagnosis_report(DIAGNOSIS), tmp_path / "a.svg")
    assert "<svg" in (tmp_path / "a.svg").read_text(encoding="utf-8")
    with pytest.raises(ValueError, match=r"\.png or \.svg"):
        write_picture(diagnosis_report(DIAGNOSIS), tmp_path / "a.gif")


def test_each_kind_of_file_has_a_report(calibration: Calibration, tmp_path: Path) -> None:
    save_calibration(calibration, tmp_path / "cal.json")
    (tmp_path / "d.json").write_text(json.dumps(DIAGNOSIS), encoding="utf-8")
    rng = np.random.default_rng(1)
    motion = bench_protocol(rng, poses=4)
    recording = simulate(motion, SensorModel(), CONSUMER, rng=rng, rate=50.0)
    write_recording(recording, tmp_path / "log.csv")
    titles = [load_report(tmp_path / name).title for name in ("cal.json", "d.json", "log.csv")]
    assert titles == ["Calibration", "Diagnosis", "Recording"]


@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium (Debian package chromium)")
@pytest.mark.parametrize(("width", "height"), [(1280, 900), (820, 1180)])
@pytest.mark.long
def test_a_browser_shows_it_without_an_error(
    calibration: Calibration, tmp_path: Path, width: int, height: int
) -> None:
    page, shot = tmp_path / "page.html", tmp_path / "shot.png"
    text = render_page(calibration_report(calibration))
    page.write_text(text.replace("<head>", f"<head>{WATCH}", 1), encoding="utf-8")
    done = subprocess.run(
        [
            str(CHROMIUM),
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--disable-quic",
            "--no-first-run",
            "--disable-background-networking",
            "--disable-component-update",
            "--disable-sync",
            f"--user-data-dir={tmp_path / 'profile'}",
            f"--window-size={width},{height}",
            "--virtual-time-budget=8000",
            f"--screenshot={shot}",
            "--dump-dom",
            page.as_uri(),
        ],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    assert "data-errors" not in done.stdout
    assert done.stdout.count('class="main-svg"') >= 4  # the charts were drawn
    assert shot.stat().st_size > 20_000
