"""Run as ``python -m imu_cli``."""

from imu_cli.app import main

main()
