"""The text filter: the same lines out as came in, corrected, whatever the pieces they come in."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.calibration import Calibration, Gravity
from calib.errors import EmptyRecordingError, RecordingFormatError
from calib.model import SensorModel, Triad
from drivers.text_filter import CsvFilter

ACCEL = Triad(np.array([0.5, 0.0, 0.0]), np.array([1.0, 0.0, 0.0]))
CALIBRATION = Calibration(
    SensorModel(ACCEL, Triad(np.array([0.25, 0.0, 0.0]))), (), np.zeros((0, 0)), (), Gravity(9.8)
)
HEADER = b"time,accel_x,accel_y,accel_z,gyro_x,gyro_y,gyro_z,temperature,lost,remark\n"


def run(*pieces: bytes) -> tuple[bytes, list[str]]:
    said: list[str] = []
    stream = CsvFilter(CALIBRATION, said.append)
    out = b"".join(stream.feed(piece) for piece in pieces)
    return out + stream.finish(), said


def test_channels_are_corrected_and_the_rest_is_kept_as_it_was() -> None:
    out, said = run(HEADER + b"0.10,1.5,2,3,0.5,5,6,25.30,0,still\n")
    # accel x: (1.5 - 0.5) / 2, gyro x: 0.5 - 0.25; "0.10" and "25.30" keep their last zero
    assert out == HEADER + b"0.10,0.5,2,3,0.25,5,6,25.30,0,still\n"
    assert not said


def test_a_line_comes_out_as_soon_as_it_ends() -> None:
    stream = CsvFilter(CALIBRATION, pytest.fail)
    assert stream.feed(HEADER) == HEADER
    assert stream.feed(b"0.1,1.5,2,3,0.5,5,6,25,0,") == b""
    assert stream.feed(b"a\n0.2,1") == b"0.1,0.5,2,3,0.25,5,6,25,0,a\n"
    assert stream.feed(b".5,2,3,0.5,5,6,25,0,b\n") == b"0.2,0.5,2,3,0.25,5,6,25,0,b\n"


TEXT = (
    b"# device: x\n\n" + HEADER + b"0.1,1.5,2,3,0.5,5,6,25,0,a\r\n"
    b"# a remark, on the way\n\n  \n0.2,1.5,2,3,0.5,5,6,25,0,b\n"
    b"0.3,oops,2,3,0.5,5,6,25,0,c\n0.4,1.5,2,3\n0.5,nan,2,3,0.5,5,6,25,0,d\n"
    b'0.6,1.5,2,3,0.5,5,6,,0,"e, f"\n0.7,1.5,2,3,0.5,5,6,25,0,g'
)


def test_comments_blank_and_damaged_lines() -> None:
    out, said = run(TEXT)
    assert out.splitlines() == [
        b"# device: x",
        b"",
        HEADER.strip(),
        b"0.1,0.5,2,3,0.25,5,6,25,0,a",
        b"# a remark, on the way",
        b"",
        b"  ",
        b"0.2,0.5,2,3,0.25,5,6,25,0,b",
        b'0.6,0.5,2,3,0.25,5,6,,0,"e, f"',
        b"0.7,0.5,2,3,0.25,5,6,25,0,g",
    ]
    assert [text.split(" is ")[0] for text in said] == ["line 9", "line 10", "line 11"]


@settings(max_examples=40, deadline=None)
@given(st.lists(st.integers(1, len(TEXT) - 1), max_size=12, unique=True))
def test_cuts_between_reads_change_nothing(cuts: list[int]) -> None:
    edges = [0, *sorted(cuts), len(TEXT)]
    pieces = [TEXT[a:b] for a, b in pairwise(edges)]
    whole, said = run(TEXT)
    out, said_again = run(*pieces)
    assert out == whole
    assert said_again == said


def test_a_quote_joins_no_lines_and_stays_where_it_is() -> None:
    row = b"0.%d,%s,2,3,0.5,5,6,25,0,%s\n"
    notes = [b"ok", b'"5 inch', b"ok", b'3" pipe', b'"a, ""b"""', b'"c', b'd"', b'"still"']
    out, said = run(HEADER, b"".join(row % (k, b"1.5", note) for k, note in enumerate(notes)))
    corrected = b"0.%d,0.5,2,3,0.25,5,6,25,0,%s\n"
    assert out == HEADER + b"".join(corrected % (k, note) for k, note in enumerate(notes))
    assert not said


def test_blanks_after_commas_quoted_numbers_and_what_cannot_be_told_apart() -> None:
    out, said = run(
        HEADER,
        b'0.1, 1.5, 2, 3, 0.5, 5, 6, 25, 0, a\n"0.2","1.5",2,3,0.5,5,6,"25",0,b\n'
        b'0.3,1.5,2,3,0.5,5,6,25,0,a\rb\n0.4,1.5,2,3,0.5,5,6,25,0,"c, d\n'
        b"0.5,1.5,2,3,0.5,5,6,25,0,\x1e\n",
    )
    assert out == (HEADER + b"0.1,0.5,2,3,0.25,5,6, 25, 0, a\n0.2,0.5,2,3,0.25,5,6,25,0,b\n")
    assert [text.split(" is ")[0] for text in said] == ["line 4", "line 5", "line 6"]


def test_a_cut_last_line_is_said_and_left_out() -> None:
    out, said = run(HEADER + b"0.1,1.5,2,3,0.5,5,6,25,0,a\n0.2,1.5,2")
    assert out.endswith(b",a\n")
    assert len(said) == 1
    assert "cut" in said[0]


@pytest.mark.parametrize(
    ("data", "error", "message"),
    [
        (b"", EmptyRecordingError, "empty"),
        (b"# only a remark\n", EmptyRecordingError, "expected the header"),
        (b"1,2,3,4,5,6,7\n", RecordingFormatError, "lacks time, accel_x"),
        (b"time,accel_x\n", RecordingFormatError, "lacks accel_y"),
        (bytes(range(256)) * 4, RecordingFormatError, "expected the header"),
        (HEADER.replace(b"lost", b"time"), RecordingFormatError, "twice"),
    ],
)
def test_what_is_no_stream_is_refused(data: bytes, error: type[Exception], message: str) -> None:
    with pytest.raises(error) as caught:
        run(data)
    assert message in str(caught.value)
