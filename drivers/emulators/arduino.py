"""An Arduino sketch that prints one line a sample: microseconds, m/s², rad/s and °C."""

from __future__ import annotations

import numpy as np

from drivers.emulators.serial_device import SerialDevice, serial_emulator

LINE = b"%d,%.4f,%.4f,%.4f,%.5f,%.5f,%.5f,%.2f\r\n"
WRAP = 2**32
"""`micros()` starts again at 0 after 71.6 minutes."""


class ArduinoSketch(SerialDevice):
    """Lines that nothing can be answered to."""

    def stream(self, start: int, stop: int) -> bytes:
        """Return one line for each sample."""
        signals, temperature = self.sensor.measure(start, stop)
        micros = np.rint(np.arange(start, stop) * (1e6 / self.sensor.rate)).astype(np.int64) % WRAP
        rows = np.hstack([signals.accel, signals.gyro, temperature[:, None]]).tolist()
        return b"".join(
            LINE % (stamp, *row) for stamp, row in zip(micros.tolist(), rows, strict=True)
        )


EMULATOR = serial_emulator(
    "arduino",
    "Arduino sketch printing CSV lines on a serial port",
    ArduinoSketch,
    default_rate=200.0,
    dialect="text",
    options="&columns=t,ax,ay,az,gx,gy,gz,temp&time_unit=us&time_wraps=4294967296"
    "&accel_unit=m/s^2&gyro_unit=rad/s",
)
