"""Heights in DJI's routes: template.kml and waylines.wpml of an unzipped KMZ. Once per file.

A route is a Folder; its mode says what the heights of its placemarks count from, which stand beside
their coordinates: `executeHeight` with `executeHeightMode` in what the drone flies, `height` with
`heightMode` in what Pilot 2 edits, or `globalHeight` where `useGlobalHeight` is 1. A mode may stand
behind its placemarks. Source: DJI, Cloud API, Wayline File Format Standard, template.kml and
waylines.wpml.
"""

from __future__ import annotations

from collections.abc import Mapping

from radiant_core.choices import HeightFrom
from radiant_core.waypoints.rows import WaypointRows, number

EXECUTED: dict[str, HeightFrom] = {"WGS84": "ellipsoid", "relativeToStartPoint": "takeoff", "realTimeFollowSurface": "ground"}
EDITED: dict[str, HeightFrom] = {
    "EGM96": "sea",
    "relativeToStartPoint": "takeoff",
    "aboveGroundLevel": "ground",
    "realTimeFollowSurface": "ground",
}
_SETTINGS = ("executeHeightMode", "heightMode", "globalHeight")


class WpmlHeights:
    """Gathers the heights of one route after another and writes them into the rows."""

    def __init__(self, rows: WaypointRows) -> None:
        self._rows = rows
        self._settings: dict[str, str] = {}
        self._waiting: list[tuple[int, Mapping[str, str]]] = []

    def take_setting(self, name: str, text: str | None) -> None:
        """An element outside of placemarks."""
        if name in _SETTINGS:
            self._settings[name] = (text or "").strip()

    def take_placemark(self, children: Mapping[str, str], before: int) -> None:
        """The texts of a placemark's children, whose one waypoint is the row `before`."""
        if len(self._rows.names) == before + 1 and children.keys() & {"executeHeight", "height", "useGlobalHeight"}:
            self._waiting.append((before, children))

    def end_folder(self) -> None:
        """Let the heights that were read count from what the route's mode says."""
        modes: dict[str, HeightFrom] = {
            "executeHeight": EXECUTED.get(self._settings.get("executeHeightMode", ""), "unknown"),
            "height": EDITED.get(self._settings.get("heightMode", ""), "unknown"),
        }
        without = 0
        for row, children in self._waiting:
            written = "executeHeight" if "executeHeight" in children else "height"
            text = children.get(written, "")
            if written == "height" and children.get("useGlobalHeight") == "1":
                text = self._settings.get("globalHeight", "")
            if text and modes[written] != "unknown":
                self._rows.set_height(row, number(text, f"the {written} of waypoint {row + 1}"), modes[written])
            without += bool(text) and modes[written] == "unknown"
        if without:
            named = [f"{name} {self._settings[name][:40]!r}" for name in _SETTINGS[:2] if self._settings.get(name)]
            reason = f"its {' and '.join(named)} is not known" if named else "it has no executeHeightMode and no heightMode"
            self._rows.notes.append(f"{without} heights of a DJI route are not used, for {reason}, which would say what they count from.")
        self._waiting.clear()
        self._settings.clear()
