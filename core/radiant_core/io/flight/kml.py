"""A route as KML (OGC 12-007r2): a point per waypoint, in the order of the flight."""

from __future__ import annotations

from xml.sax.saxutils import escape

import numpy as np

from radiant_core.io.flight.route import Route
from radiant_core.plan.heights import FROM_THE_SEA, HEIGHT_KINDS

NO_TAKE_OFF = "KML has no mode for that, and relativeToGround, which stands here, is the same over level ground alone"


def kml_route(route: Route) -> bytes:
    """The file's content. No line joins the points: readers would take its vertices for waypoints
    of their own. Absolute heights are those above sea level; BadInput where these are not known."""
    is_absolute = np.isin(route.height_codes, [HEIGHT_KINDS.index(kind) for kind in FROM_THE_SEA])
    heights_m = np.where(is_absolute, route.heights_above("sea"), route.heights_m) if is_absolute.any() else route.heights_m
    note = f"{route.heights_text}; {NO_TAKE_OFF}" if "takeoff" in route.kinds else route.heights_text
    points = [
        f"<Placemark><name>{escape(name)}</name><Point><altitudeMode>{'absolute' if absolute else 'relativeToGround'}</altitudeMode>"
        f"<coordinates>{lon:.9f},{lat:.9f},{height:.3f}</coordinates></Point></Placemark>"
        for name, (lat, lon), height, absolute in zip(
            route.names, route.lat_lon.tolist(), heights_m.tolist(), is_absolute.tolist(), strict=True
        )
    ]
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        '<kml xmlns="http://www.opengis.net/kml/2.2">',
        f"<Document><name>{escape(route.name)}</name><description>{escape(note)}</description>",
        *points,
        "</Document>",
        "</kml>",
    ]
    return ("\n".join(lines) + "\n").encode()
