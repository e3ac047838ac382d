"""What the window offers its docks and tools: protocols, the two views, a picture label. Needs the
`desktop` extra."""
