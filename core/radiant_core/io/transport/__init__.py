"""What crosses from one tier to another: uploads, signed deliveries, and which of them a receiver accepts."""
