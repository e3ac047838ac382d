"""Ground control and positions of known accuracy in the adjustment of all photographs."""
