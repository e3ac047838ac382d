"""The docks of the window, one file each. Needs the `desktop` extra."""
