"""Plans under change: edits, files and the tools of the map."""
