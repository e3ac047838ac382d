"""The docks of the window, one file each; they see its protocols in `host`. Needs the `desktop` extra."""
