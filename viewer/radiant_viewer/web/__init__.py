"""The page for a browser, drawn on the machine that has the run."""
