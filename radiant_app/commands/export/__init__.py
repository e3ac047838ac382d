"""A run or a model in the files of other programs."""
