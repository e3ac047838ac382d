"""Places in systems by others than PROJ, each with its source: what a test compares with.

OSTN15: Ordnance Survey, OSTN15-OSGM15 developers' pack (2016), OSTN15_OSGM15_TestInput_ETRStoOSGB
and …TestOutput_ETRStoOSGB: latitude, longitude, ellipsoidal height on ETRS89; easting, northing on
the National Grid, height on Newlyn. ETRS89 is taken for WGS84, as everywhere: half a metre by 2020.
"""

from __future__ import annotations

OSTN15 = {
    "TP01": ((49.92226393730, -6.29977752014, 100.000), (91492.146, 11318.804, 46.519)),
    "TP09": ((51.48936564950, -0.11992557180, 66.057), (530624.974, 178388.464, 20.544)),
    "TP20": ((53.80021519630, -1.66379168242, 215.609), (422242.186, 433818.701, 165.912)),
    "TP26": ((55.85399952950, -4.29649016251, 71.617), (256340.925, 664697.269, 17.459)),
    "TP40": ((60.13308091660, -2.07382822798, 140.716), (395999.668, 1138728.951, 90.015)),
}

FEET_M = {
    # Metres of a unit, by definition: international foot (1959), US survey foot (1893: 1200/3937),
    # Clarke's link, a hundredth of Clarke's chain of 66 of his feet of 0.3047972654 m, and Gold
    # Coast foot: EPSG dataset v11.022, units 9002, 9003, 9039, 9094.
    "foot": 0.3048,
    "US survey foot": 1200 / 3937,
    "Clarke's link": 0.3047972654 * 66 / 100,
    "Gold Coast foot": 6378300 / 20926201,
    "kilometre": 1000.0,
}
