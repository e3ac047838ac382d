"""The Qt window, its two views and its menus. Needs the `desktop` extra."""
