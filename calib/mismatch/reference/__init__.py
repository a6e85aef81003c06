"""A recording beside a truth: a simulation, motion capture, a table, another IMU."""
