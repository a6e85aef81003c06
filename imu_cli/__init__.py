"""The command line of imu-cal: parse, call the library function of the same verb, print."""
