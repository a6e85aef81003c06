"""Serial protocols, bytes to samples, pure: one file each."""
