"""Machines that train one model together: what travels between them in every optimiser step."""
