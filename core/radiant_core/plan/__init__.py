"""Regions per edge (ARP) and quotas per device (RTP), by numpy and scipy only, never torch."""
