"""The file that says which face was up."""

from pathlib import Path

import pytest

from calib.errors import RecordingFormatError
from calib.housing import FacePose
from drivers.faces_file import read_faces


def write(tmp_path: Path, text: str, name: str = "faces.csv") -> Path:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


def test_csv_and_toml(tmp_path: Path) -> None:
    expected = (FacePose("+Z", time=12.5), FacePose("-X", pose=3))
    text = "# remark\ntime, pose, up\n12.5,,+z\n\n,3,-X\n"
    assert read_faces(write(tmp_path, text)) == expected
    toml = '[[pose]]\ntime = 12.5\nup = "+Z"\n[[pose]]\npose = 3\nup = "-X"\n'
    assert read_faces(write(tmp_path, toml, "faces.toml")) == expected


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.csv", "", "header `time,up`"),
        ("a.csv", "time,up\n", "names no pose"),
        ("a.csv", "a,b\n1,2\n", "header `time,up`"),
        ("a.csv", "time,up\n1,up\n", "line 2: up is 'UP'"),
        ("a.csv", "time,up\nsoon,+X\n", "line 2: expected a time"),
        ("a.csv", "pose,up\n1.5,+X\n", "line 2: expected a time"),
        ("a.toml", "[[pose]\n", "not TOML"),
        ("a.toml", "pose = 3\n", "expected tables"),
        ("a.toml", '[[pose]]\nup = "+X"\n', "expected a time"),
    ],
)
def test_what_is_wrong_is_said(tmp_path: Path, name: str, text: str, message: str) -> None:
    with pytest.raises(RecordingFormatError) as caught:
        read_faces(write(tmp_path, text, name))
    assert message in str(caught.value)


def test_a_missing_file(tmp_path: Path) -> None:
    with pytest.raises(RecordingFormatError, match="cannot read"):
        read_faces(tmp_path / "none.csv")
