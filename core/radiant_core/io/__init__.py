"""Strict readers and atomic writers; the only place where files become types."""
