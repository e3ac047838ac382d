"""Who captures and trains what: regions per edge (ARP), quotas per device (RTP). numpy and scipy
only, never torch."""
