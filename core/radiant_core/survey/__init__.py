"""What a client of a survey asks for: orthophoto, heights, measures, change between dates."""
