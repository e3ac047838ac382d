"""Training of one model from one set of photographs."""
