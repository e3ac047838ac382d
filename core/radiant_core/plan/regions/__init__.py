"""Which edge owns which cameras (paper Sec. III-B, ARP): transport to the cells of a power diagram."""
