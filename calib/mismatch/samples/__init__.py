"""What shows in samples and not in their means: lost, clipped, coarse, lines, pulses."""
