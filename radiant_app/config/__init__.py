"""The one configuration of a run: its fields, and the options, files and paths made from them."""
