"""Which explanation is best, at levels of noise of its own, fitted jointly with all others."""
