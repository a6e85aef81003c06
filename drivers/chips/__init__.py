"""Register maps of I2C chips: one file each."""
