"""Features, previews and matches that cost less than COLMAP's own; numpy and OpenCV only."""
