"""The window before there is a run: choose photographs, machines and quality. Needs `desktop`."""
