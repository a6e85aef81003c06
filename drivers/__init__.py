"""Devices and files in, samples out. Imports `calib`, never `imu_cli`."""
