"""Ways to reach a device: serial port, I2C bus, replayed file, emulator; one file each."""
