"""Solvers, one file each.

An accelerometer solver has ``ACCEL_SOLVER``, a gyroscope solver ``GYRO_SOLVER``.
"""
