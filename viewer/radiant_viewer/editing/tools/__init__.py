"""What a user does to a plan: actions, tools of the map, and the layers that follow."""
