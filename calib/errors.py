"""The error tree. Every error that a user can cause or meet is one of these.

::

    ImuError
    ├── RecordingError                  the input cannot be used           exit 3
    │   ├── RecordingNotFoundError      no such file, or a directory
    │   ├── RecordingFormatError        not a log, unknown or damaged format
    │   ├── EmptyRecordingError         no samples in it
    │   ├── InvalidSampleError          NaN, infinite, time not increasing
    │   ├── UnitError                   values do not have the declared unit
    │   ├── NoCommonMotionError         two recordings do not show one motion
    │   └── RecordingWriteError         disk full, no such folder, not allowed
    ├── CalibrationError                no (whole) answer from this data   exit 4
    │   ├── InsufficientMotionError     the poses or turns do not determine it
    │   └── NotConvergedError           the solver did not settle
    ├── CalibrationFileError            a calibration file cannot be used  exit 10
    ├── AddressError                    a device address is not understood exit 2
    └── DriverError                     devices                            exit 7
        ├── DeviceNotFoundError
        ├── DevicePermissionError
        ├── DeviceBusyError             someone else has the port
        ├── WrongDeviceError            another chip answered
        ├── BadFrameError
        ├── DriverTimeoutError
        ├── DeviceLostError             it answered, and then went away
        └── FlashError                  not written; the old values are back      exit 8
            └── FlashStateError         the device's state is not what it was     exit 9

Exit 0 is success, 1 a bug in imu-cal, 2 wrong usage, 5 a partial result, 6 a check that said no
(``verify``, ``--strict``, a FAIL on the line), 11 a run of the line that ended in ERROR, 130 an
interruption. A bad argument of a library function is a `ValueError` that names the argument in
backticks.

A message says what was seen, what was expected, and what to do next.
"""

from __future__ import annotations

from typing import ClassVar


class ImuError(Exception):
    """Base of everything that imu-cal raises on purpose."""

    exit_code: ClassVar[int] = 1


class RecordingError(ImuError):
    """A recording cannot be used."""

    exit_code = 3


class RecordingNotFoundError(RecordingError, FileNotFoundError):
    """There is no such file, or it is a directory."""

    def __str__(self) -> str:  # OSError would print only errno and strerror
        return str(self.args[0]) if self.args else ""


class RecordingFormatError(RecordingError, ValueError):
    """The file is not a log of a known format, or is damaged."""


class EmptyRecordingError(RecordingError, ValueError):
    """The file holds no samples."""


class InvalidSampleError(RecordingError, ValueError):
    """A sample is NaN, infinite, or not later than the one before it."""


class UnitError(RecordingError, ValueError):
    """The values do not have the unit that was declared."""


class NoCommonMotionError(RecordingError, ValueError):
    """Two recordings, or a recording and a reference, do not show the same motion."""


class RecordingWriteError(RecordingError, OSError):
    """A recording cannot be written; what was written before stays readable."""

    def __str__(self) -> str:
        return str(self.args[0]) if self.args else ""


class CalibrationError(ImuError):
    """The data gives no whole calibration."""

    exit_code = 4


class InsufficientMotionError(CalibrationError, ValueError):
    """The poses or turns do not determine the parameters; the message names them."""


class NotConvergedError(CalibrationError, ArithmeticError):
    """An iteration did not settle."""


class CalibrationFileError(ImuError, ValueError):
    """A calibration file is damaged, of an unknown version, or in a wrong unit."""

    exit_code = 10


class AddressError(ImuError, ValueError):
    """A device address, or an option in it, is not understood."""

    exit_code = 2


class DriverError(ImuError):
    """A device could not be used."""

    exit_code = 7


class DeviceNotFoundError(DriverError):
    """Nothing answers at this address."""


class DevicePermissionError(DriverError, PermissionError):
    """The operating system does not let us open it."""

    def __str__(self) -> str:
        return str(self.args[0]) if self.args else ""


class DeviceBusyError(DriverError):
    """Someone else is using it."""


class WrongDeviceError(DriverError):
    """Another chip answered than the one that was named."""


class BadFrameError(DriverError, ValueError):
    """Bytes that are no frame of the dialect."""


class DriverTimeoutError(DriverError, TimeoutError):
    """The device did not answer in time."""

    def __str__(self) -> str:
        return str(self.args[0]) if self.args else ""


class DeviceLostError(DriverError):
    """The device answered before, and went away."""


class FlashError(DriverError):
    """Writing failed; the old values are back in the device."""

    exit_code = 8


class FlashStateError(FlashError):
    """Writing failed and the old values could not be restored; the message says what is there."""

    exit_code = 9
