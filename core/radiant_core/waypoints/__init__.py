"""Waypoints and regions from the files of flight planners and maps: CSV, GeoJSON, KML."""
