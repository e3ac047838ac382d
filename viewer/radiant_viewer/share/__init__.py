"""A scene as a page that flies through it: a folder for any static host, or one HTML file."""
