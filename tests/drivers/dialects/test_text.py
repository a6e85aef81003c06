import numpy as np
import pytest

from calib.errors import AddressError, BadFrameError
from calib.gravity import STANDARD_GRAVITY
from drivers.dialects.base import DEGREE
from drivers.dialects.text import DIALECT, TextParser

OPTIONS = {
    "columns": "t,ax,ay,az,gx,gy,gz",
    "time_unit": "ms",
    "accel_unit": "g",
    "gyro_unit": "deg/s",
}
ROWS = np.array([[10.0 * k, 0.5, -0.25, 1.0, k, -2.0, 0.125] for k in range(1, 4)])


def parse(data: bytes, **options: str) -> tuple[TextParser, list[list[float]], list[int]]:
    parser = DIALECT.parser(OPTIONS | options)
    assert isinstance(parser, TextParser)
    samples = parser.feed(b"half a line\n" + data)
    assert samples.ticks is not None
    rows = np.column_stack(
        [samples.ticks * 1e3, samples.accel / STANDARD_GRAVITY, samples.gyro / DEGREE]
    )
    return parser, rows.tolist(), samples.lost.tolist()


def lines(form: str) -> bytes:
    return "".join(form.format(*row) for row in ROWS).encode()


@pytest.mark.parametrize(
    "form",
    [
        "{},{},{},{},{},{},{}\n",
        "{}, {}, {}, {}, {}, {}, {}\r\n",
        "{};{};{};{};{};{};{}\n",
        "{}\t{}\t{}\t{}\t{}\t{}\t{}\n",
        " {}  {}   {} {} {} {} {} \r\n",
        "t:{}\tax:{}\tay:{}\taz:{}\tgx:{}\tgy:{}\tgz:{}\n",
        "t: {}, ax: {}, ay: {}, az: {}, gx: {}, gy: {}, gz: {}\n",
        '{{"t":{},"ax":{},"ay":{},"az":{},"gx":{},"gy":{},"gz":{}}}\n',
    ],
)
def test_reads_what_sketches_print(form: str) -> None:
    parser, rows, lost = parse(lines(form))
    assert np.allclose(rows, ROWS)
    assert lost == [0, 0, 0]
    assert DIALECT.recognise(b"x\n" + lines(form) * 20) > 0.9
    assert set(parser.counters) == {"incomplete_bytes"}


@pytest.mark.parametrize("copies", [1, 100])
@pytest.mark.parametrize(
    "damage",
    [
        b"20.0,0.5,-0.25,1.0,2,-2.0\n",
        b"20.0,0.5,-0.25,1.0,2,-2.0,0.1.25\n",
        b"20.0,0.5,-0.25,1.0,2,-2.0,0.125,7\n",
        b"20.0,0.5,-0.25,1.0,2,,0.125\n",
        b"20.0,0.5,-0.25,1.0,2,-2.0,nan\n",
        b"20.0,0.5,-0.25,1.0,2,-2.0,1e999\n",
        b"20.0,0.5,-0.25,1.0,2,-2.0,\xff12\n",
        b"20.0,0.5,-0.25,1.0,2,-2.0,0x1F\n",
        b"20.0,0.5,-0.25,1.0,2,-2.0,1_000\n",
        b"20.0,0.5,-0.25,1.0,2,-2.0,--1\n",
        b"20.0,0.5,-0.25,1.0,2,-2.0,1 2\n",
        b"20.0,0.5,-0.25,1.0,2,-2.0,5e\n",
        b'20.0,0.5,-0.25,1.0,2,-2.0,"1\n',
    ],
)
def test_a_damaged_line_costs_itself_alone(damage: bytes, copies: int) -> None:
    good = b"10.0,0.5,-0.25,1.0,1,-2.0,0.125\n"
    parser, rows, lost = parse(good * copies + damage + good * copies)
    assert len(rows) == 2 * copies
    assert lost == [0] * copies + [1] + [0] * (copies - 1)
    assert parser.counters["damaged_lines"] == 1


def test_text_for_people_is_no_lost_sample() -> None:
    data = b"# boot\n10,0,0,1,0,0,0\nCalibrating, please wait...\n\n\r\n20,0,0,1,0,0,0\n"
    parser, rows, lost = parse(data)
    assert len(rows) == 2
    assert lost == [0, 0]
    assert parser.counters["other_lines"] == 2


def test_json_paths_and_damage() -> None:
    good = b'{"t":1,"ax":0,"ay":0,"az":1,"gx":0,"gy":0,"gz":0}\n'
    bad = [
        b'{"t":1,"ax":0\n',
        b'{"t":1,"ax":"0","ay":0,"az":1,"gx":0,"gy":0,"gz":0}\n',
        b"[" * 9999,
    ]
    parser, _, lost = parse(good + bad[0] + good + bad[1] + bad[2] + b"\n" + good)
    assert lost == [0, 1, 2]
    assert parser.counters["damaged_lines"] == 3


def test_a_line_without_end_does_not_fill_the_memory() -> None:
    parser = DIALECT.parser(OPTIONS)
    for _ in range(100):
        parser.feed(b"1" * 1000)
    assert parser.counters["skipped_bytes"] >= 95_000


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({}, "told what their columns are"),
        ({"columns": "t,ax,ay"}, "lacks az"),
        ({**OPTIONS, "accel_unit": "furlong"}, "furlong"),
        ({k: v for k, v in OPTIONS.items() if k != "gyro_unit"}, "unit must be one of"),
        ({**OPTIONS, "time_wraps": "often"}, "TOML"),
        ({"profile": "no-such-profile"}, "no import profile"),
    ],
)
def test_options_are_checked(options: dict[str, str], says: str) -> None:
    with pytest.raises(AddressError, match=says):
        DIALECT.parser(options)


def test_columns_that_the_lines_do_not_have() -> None:
    parser = DIALECT.parser(OPTIONS)
    with pytest.raises(BadFrameError, match="only 6"):
        parser.feed(b"\n1,2,3,4,5,6\n1,2,3,4,5,6\n")
