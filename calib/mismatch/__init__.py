"""Recording minus simulation: where, what, how much, proven on held-out data."""
