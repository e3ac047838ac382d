"""A route as KML (OGC 12-007r2): a point per waypoint, in the order of the flight."""

from __future__ import annotations

from xml.sax.saxutils import escape

from radiant_core.io.flight.route import SAID, Route

MODE = {"takeoff": "relativeToGround", "absolute": "absolute"}
"""KML knows the ground below and not take-off: over level ground both are one."""


def kml_route(route: Route) -> bytes:
    """The file's content. No line joins the points: readers would take its vertices for waypoints
    of their own."""
    mode = f"<altitudeMode>{MODE[route.heights]}</altitudeMode>"
    places = [
        f"{lon:.9f},{lat:.9f},{height:.3f}" for (lat, lon), height in zip(route.lat_lon.tolist(), route.heights_m.tolist(), strict=True)
    ]
    points = [
        f"<Placemark><name>{escape(name)}</name><Point>{mode}<coordinates>{place}</coordinates></Point></Placemark>"
        for name, place in zip(route.names, places, strict=True)
    ]
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        '<kml xmlns="http://www.opengis.net/kml/2.2">',
        f"<Document><name>{escape(route.name)}</name><description>{SAID[route.heights]}</description>",
        *points,
        "</Document>",
        "</kml>",
    ]
    return ("\n".join(lines) + "\n").encode()
