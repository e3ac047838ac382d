"""The one configuration of a run: its fields, and the options, files and `--set` paths that are made from them."""
