"""Plans, scenes and models as files that other programs open."""
