"""The production line: station files, limits, the unattended run, and the history of every unit."""
