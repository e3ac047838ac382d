"""Strips of an edge's region for its devices (paper Sec. III-C, RTP)."""
