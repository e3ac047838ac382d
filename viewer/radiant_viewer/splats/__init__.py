"""The model itself, drawn in processes of its own."""
