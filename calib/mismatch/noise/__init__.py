"""What judges it: the noise of samples, of the biases' drift, and of closures."""
