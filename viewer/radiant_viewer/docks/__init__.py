"""The docks of the window, one file each; they see it through `host`. Needs the `desktop` extra."""
