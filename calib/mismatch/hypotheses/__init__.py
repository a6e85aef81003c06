"""What may explain a residual: the catalogue and its rivals, as columns with prior weights."""
