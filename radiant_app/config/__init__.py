"""The one configuration of a run: its fields, and the options, files and `--set` paths of them."""
