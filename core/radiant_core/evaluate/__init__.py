"""How good a model is: splits, image errors, seam errors, metrics."""
