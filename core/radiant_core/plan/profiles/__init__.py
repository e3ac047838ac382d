"""What machines cost: profiles, fitted cost curves, the capacity of an edge."""
