"""What this machine has, and what it takes to train and to join here."""
