"""Every helper of a training on every kind of scene: what it gains, and whether it is ever worse than none."""
