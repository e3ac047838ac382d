"""Where a scene lies on the globe: coordinate reference systems, and what says so beside a file."""
