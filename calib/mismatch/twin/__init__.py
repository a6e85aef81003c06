"""The digital twin of a recording: attitudes and a sensor model that reproduce it."""
