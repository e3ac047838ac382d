"""The web page of a run, rendered on the machine that has it."""
