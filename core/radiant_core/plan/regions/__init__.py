"""Which edge owns which cameras (paper Sec. III-B, ARP): transport to cells of a power diagram."""
