"""Borders between regions: what images see of them, forecasts and buffer captures."""
