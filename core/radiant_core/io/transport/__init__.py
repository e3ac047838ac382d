"""What crosses from one tier to another: uploads, signed deliveries, and their acceptance."""
