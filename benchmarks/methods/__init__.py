"""Ways of making one model with many machines, on equal photographs, plans and steps."""
