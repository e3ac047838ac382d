"""Cameras of each edge (paper Sec. III-B, ARP): transport to the cells of a power diagram."""
