"""What is looked at: the grid of a recording, closures of its turns, and rows of residuals."""
