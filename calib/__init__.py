"""The science of imu-cal: numpy and scipy only, no I/O, no clock, no global random state.

This page is the one place where models, frames, units, time, signs and names are fixed.

The forward model
-----------------
For each triad (accelerometer, gyroscope)::

    measured = (I + S + M) @ true + bias + further terms + noise

- ``S`` diagonal: ``scale_factor_error`` (1). The paper's scale factor is ``s = 1 + S_ii``.
- ``M`` zero on its diagonal: ``misalignment`` (rad). ``M[i, j]`` is what axis ``i`` sees of ``j``.
  For the accelerometer ``M`` is strictly lower triangular (the paper's ``m1 = M[1, 0]``,
  ``m2 = M[2, 0]``, ``m3 = M[2, 1]``); for the gyroscope it is full.
- ``bias`` is in output units: it is added after the matrix.
- ``further terms`` come from `calib.effects`, one file each, and are functions of the true state.

`calib.model.SensorModel` holds it; its ``distort`` and ``correct`` are each other's inverse. The
simulator, every solver, ``apply`` and the diagnosis use that one class. Other tools' conventions
are converted where they are read or written, nowhere else.

Frames
------
- ``s``, the sensor frame: right-handed, defined by the accelerometer. ``x_s`` is along the
  accelerometer's x input axis and ``y_s`` lies in the plane of its x and y axes, which is
  what makes its ``M`` lower triangular. The gyroscope is calibrated *to this frame*.
- ``n``, the navigation frame: east, north, up. Gravity pulls along ``-z_n``.
- ``mat_ab`` takes vectors from frame ``b`` to frame ``a``: ``vec_a = mat_ab @ vec_b``. The
  sensor's orientation is ``mat_ns``; its quaternions are scalar-first ``(w, x, y, z)``.

Signals
-------
- ``accel`` is specific force, m/s². A sensor at rest with z up reads ``(0, 0, +g)``.
- ``gyro`` is the angular rate of ``s`` relative to ``n``, resolved in ``s``, rad/s, right-hand
  rule: ``d(mat_ns)/dt = mat_ns @ skew(gyro)``.
- ``temperature`` is °C. Degrees, g, dps and LSB exist only at the edges (`drivers` and
  `imu_cli.output`).

Time
----
``time`` is seconds on the recording's own clock, strictly increasing, not necessarily even. Sample
``k`` is the signal at ``time[k]``; integrals are trapezoidal in the measured rate over true time,
so nothing assumes an even rate. ``lost[k]`` counts samples known to be missing just before sample
``k``. Intervals are ``[t0, t1]`` in recording seconds, index ranges ``[start, stop)``. Stamps that
scatter are evened out before anything is integrated, if samples show that they were taken evenly
(`calib.timing`); coarse ones are as a log is read (`calib.rounded_stamps`).

Noise
-----
``noise_density`` N is one-sided, per √Hz: white noise of per-sample standard deviation sigma at
rate r has ``N = sigma * sqrt(2 / r)``. ``bias_instability``, ``rate_random_walk`` (and its
accelerometer twin) and ``quantization_noise`` are as in IEEE 952.

Names
-----
Parameters are written ``triad.group.index``: ``accel.bias.x``, ``gyro.scale_factor_error.z``,
``gyro.misalignment.xy``, and for further terms ``effect.parameter``, such as
``gyro_g_sensitivity.xy``. Channels are ``accel.x`` to ``gyro.z``. The words are those of IEEE 528,
952, 1293 and 2700: bias, scale_factor_error, misalignment, g_sensitivity, bias_tempco.

References
----------
.. [1] S. Ranjbaran, A. Roudbari, S. Ebadollahi, "A Simple and Fast Method for Field Calibration of
   Triaxial Gyroscope by Using Accelerometer", JECEI 6(1), 2018.
.. [2] IEEE Std 952-1997, Annex C (noise terms); IEEE Std 1293-2018 (accelerometer model equation).
"""

from calib.errors import ImuError
from calib.fit import Fit
from calib.model import SensorModel, Triad
from calib.recording import CHANNELS, DeviceInfo, Recording

__all__ = ["CHANNELS", "DeviceInfo", "Fit", "ImuError", "Recording", "SensorModel", "Triad"]
