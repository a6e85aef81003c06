"""An output does not take the place of a device, a pipe, or a link."""

import os
import stat
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from calib.calibration import Calibration, Gravity
from calib.errors import CalibrationFileError, RecordingWriteError
from calib.model import SensorModel
from calib.recording import Recording
from drivers.calibration_file import check_can_write, save_calibration, write_atomic
from drivers.formats import read_recording, write_recording
from drivers.output_file import can_replace

pytestmark = pytest.mark.skipif(os.name != "posix", reason="devices and links are POSIX")
RECORDED = (".csv", ".arrow", ".parquet", ".feather")


def a_recording(n: int = 20_000) -> Recording:
    return Recording(np.arange(n) * 0.01, np.ones((n, 3)), np.ones((n, 3)), clock="device")


def write(path: Path) -> None:
    """Write what the suffix says."""
    if path.suffix == ".html":
        write_atomic(path, "a page" * 9000)
    elif path.suffix == ".json":
        model = Calibration(SensorModel(), (), np.zeros((0, 0)), (), Gravity(9.81))
        save_calibration(model, path)
    else:
        write_recording(a_recording(), path)


@pytest.fixture
def full_device(tmp_path: Path) -> Callable[[str], Path]:
    """Make a disk that is full: a node of this test's own, never the machine's."""

    def make(name: str) -> Path:
        path = tmp_path / name
        try:
            os.mknod(path, 0o666 | stat.S_IFCHR, os.makedev(1, 7))
            with path.open("wb"):
                pass
        except OSError:
            pytest.skip("only root makes devices, where the disk allows them")
        return path

    return make


@pytest.mark.parametrize("suffix", [".html", ".json", *RECORDED])
@pytest.mark.parametrize("linked", [False, True])
def test_a_device_stays_a_device(
    full_device: Callable[[str], Path], suffix: str, linked: bool
) -> None:
    """Root's `-o /dev/null` put a file in the place of the machine's null device."""
    device = full_device(f"full{suffix}")
    path = device
    if linked:
        path = device.with_name(f"link{suffix}")
        path.symlink_to(device)
    before = sorted(os.listdir(device.parent))
    with pytest.raises((CalibrationFileError, RecordingWriteError), match="No space left"):
        write(path)
    assert stat.S_ISCHR(device.stat().st_mode)
    assert path.is_symlink() == linked
    assert sorted(os.listdir(device.parent)) == before


@pytest.mark.parametrize("suffix", [".html", ".json", *RECORDED])
def test_a_link_keeps_pointing_where_it_points(tmp_path: Path, suffix: str) -> None:
    (tmp_path / "there").mkdir()
    target, link = tmp_path / "there" / f"a{suffix}", tmp_path / f"link{suffix}"
    target.write_text("old", encoding="utf-8")
    link.symlink_to(target)
    write(link)
    assert link.is_symlink()
    assert target.stat().st_size > 100
    assert os.listdir(tmp_path / "there") == [target.name]
    if suffix in RECORDED:
        assert len(read_recording(target)) == 20_000


def test_what_is_no_regular_file_is_not_replaced(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "file").touch()
    assert not can_replace(tmp_path / "pipe")
    assert can_replace(tmp_path / "file")
    assert can_replace(tmp_path / "new")
    check_can_write(tmp_path / "pipe")
    assert stat.S_ISFIFO((tmp_path / "pipe").stat().st_mode)
