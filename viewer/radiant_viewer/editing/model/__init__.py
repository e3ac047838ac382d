"""A plan under change as values: its wishes, its edits, how two plans differ, its figures."""
