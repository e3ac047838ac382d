"""What solves edits: with undo, and on a thread beside the window."""
