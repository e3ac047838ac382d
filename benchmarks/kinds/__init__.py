"""Every helper of a training on every kind of scene: what it gains or costs."""
