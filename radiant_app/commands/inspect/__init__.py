"""A run that is looked at: in a window, in a picture, on a page."""
