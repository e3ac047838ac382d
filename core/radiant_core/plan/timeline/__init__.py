"""When the stages of a plan happen: predicted, and simulated for whole fleets."""
