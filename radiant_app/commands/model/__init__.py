"""What is done with a finished model: joined, extended, cleaned, scored and drawn."""
