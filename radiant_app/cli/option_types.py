"""Options that several commands have; those of a run are its fields' own, the others stand here."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from radiant_app.cli.config_options import option
from radiant_app.config.run_config import GROUPS, OUTPUT
from radiant_core.aggregate.config import AggregatePreset
from radiant_core.choices import Contradictions, CutBy, Effort, Heights, LpipsNetwork, MaskIgnores, Matching, Panoramas, PlanMethod
from radiant_core.train.config import Preset

BEFORE_CAPTURE, FLIGHT, COORDINATES, LATER = "Before capture", "Flight lists", "Coordinates", "After a device died, slowed down or joined"
NEXT = "Where to fly next"
PlanSource = Annotated[
    Path | None, typer.Argument(help="Waypoints (CSV, GeoJSON, KML), photographs with GPS, a scene, a run.", show_default=False)
]
PlanOut = Annotated[
    Path, typer.Option("--out", help="File of the plan; its picture and exports are written beside it.", show_default=False)
]
PlanSettings = Annotated[
    list[str] | None,
    typer.Option("--set", help="d and T_thres of Alg. 1: plan.boundary_step=0.02, plan.threshold=0.1; repeatable.", rich_help_panel=OUTPUT),
]
CompareOption = Annotated[
    bool, typer.Option("--compare", help="Print a table of all methods on the same positions.", rich_help_panel=GROUPS["plan"])
]
SlackOption = Annotated[
    float | None,
    typer.Option(min=1, help="Allow this many times the shortest makespan for shorter ways: 1.1.", rich_help_panel=GROUPS["plan"]),
]
SlackCurveOption = Annotated[
    bool, typer.Option("--slack-curve", help="Table and picture of what several slacks gain.", rich_help_panel=GROUPS["plan"])
]
ConstraintsOption = Annotated[
    Path | None, typer.Option(help="TOML of fixed weights, locked regions, pinned cameras.", rich_help_panel=GROUPS["plan"])
]
PlannedTraining = Annotated[
    Preset, option("train.preset", help="Training to plan for: memory limits and measured curves.", group=GROUPS["train"])
]
NextOption = Annotated[
    Path | None,
    typer.Option("--next", metavar="RUN", help="Finished run, or folder of `radiant train`, to photograph better.", rich_help_panel=NEXT),
]
PhotographsOption = Annotated[
    int | None,
    typer.Option("--photographs", min=1, help="Propose this many; without it and --batteries, only the map.", rich_help_panel=NEXT),
]
BatteriesOption = Annotated[
    int | None, typer.Option("--batteries", min=1, help="Propose what this many batteries of each device last for.", rich_help_panel=NEXT)
]
CellOption = Annotated[
    float | None,
    typer.Option("--resolution", min=1e-6, help="Metres of a cell; by default four pixels of the photographs.", rich_help_panel=NEXT),
]
SafeOption = Annotated[float, typer.Option("--safe", min=0.1, help="Least metres from every surface of the model.", rich_help_panel=NEXT)]
TakeOffOption = Annotated[
    float | None, typer.Option("--take-off", help="Height of take-off on the map; by default that of low ground.", rich_help_panel=NEXT)
]
NoFlyOption = Annotated[
    list[Path] | None, typer.Option("--no-fly", help="GeoJSON polygon that is not flown over; repeatable.", rich_help_panel=NEXT)
]
AfterOption = Annotated[
    Path | None, typer.Option("--after", metavar="PLAN|RUN", help="Plan of waypoints or run to plan again.", rich_help_panel=LATER)
]
DeadOption = Annotated[list[str] | None, typer.Option("--dead", help="Device or edge that is gone; repeatable.", rich_help_panel=LATER)]
SlowOption = Annotated[
    list[str] | None,
    typer.Option("--slow", metavar="ID=FACTOR", help="It takes this many times longer; repeatable.", rich_help_panel=LATER),
]
BusyOption = Annotated[
    list[str] | None,
    typer.Option("--busy", metavar="ID=SECONDS", help="It can only start after this time; repeatable.", rich_help_panel=LATER),
]
DoneOption = Annotated[
    list[str] | None, typer.Option("--done", help="Device or edge that has finished; repeatable.", rich_help_panel=LATER)
]
JoiningOption = Annotated[
    Path | None,
    typer.Option("--join", help="System file of edges, or of devices at existing edges, that join.", rich_help_panel=LATER),
]
CapturedOption = Annotated[
    Path | None,
    typer.Option(
        "--captured", help="Waypoint file or folder of photographs that were captured and stay where they are.", rich_help_panel=LATER
    ),
]
ToleranceOption = Annotated[
    float,
    typer.Option("--tolerance", min=0, help="Share by which the makespan may exceed the least, to move fewer.", rich_help_panel=LATER),
]
GroundOption = Annotated[
    float | None,
    typer.Option("--ground", help="Altitude of the ground, in metres as in the waypoints; by default 0.", rich_help_panel=BEFORE_CAPTURE),
]
FieldOfViewOption = Annotated[
    float | None,
    typer.Option("--field-of-view", help="Degrees across an image; by default by EXIF, else 73.7.", rich_help_panel=BEFORE_CAPTURE),
]
BufferOption = Annotated[
    str | None,
    typer.Option(
        "--buffer", help="Also capture a neighbour's views: 20% of this region seen, or 15m from it.", rich_help_panel=BEFORE_CAPTURE
    ),
]
DeadlineOption = Annotated[
    float | None,
    typer.Option(
        "--deadline",
        min=0,
        help="Seconds in which an edge accepts buffer captures; with --next, trains, joins and sends its new photographs.",
        rich_help_panel=BEFORE_CAPTURE,
    ),
]
CutByOption = Annotated[CutBy, option("plan.cut_by")]
RasterCellOption = Annotated[float | None, option("plan.raster_cell_m")]
CrsOption = Annotated[
    str | None,
    typer.Option(
        "--crs",
        metavar="EPSG:NNNN[+MMMM]",
        help="Coordinate system of the file, +MMMM its vertical datum; also a PROJ string or WKT.",
        rich_help_panel=COORDINATES,
    ),
]
FileCrsOption = Annotated[
    str | None,
    typer.Option(
        "--crs",
        metavar="EPSG:NNNN[+MMMM]",
        help="Coordinate system of the file, +MMMM its vertical datum; also a PROJ string, WKT, or given: that of the COLMAP model.",
        rich_help_panel=COORDINATES,
    ),
]
WholeLinesOption = Annotated[
    float | None,
    typer.Option(min=1, help="Let devices fly whole lines within this many times the shortest makespan: 1.05.", rich_help_panel=FLIGHT),
]
FlightFormatOption = Annotated[
    str | None,
    typer.Option(metavar="kmz,plan,kml", help="Flight lists beside CSV: DJI (WPML in KMZ), QGroundControl, KML.", rich_help_panel=FLIGHT),
]
HeightsOption = Annotated[
    Heights | None, typer.Option(help="Zero of heights in these lists; by default take-off where that is known.", rich_help_panel=FLIGHT)
]
FlightHeightOption = Annotated[
    float | None, typer.Option("--height", help="Metres above take-off at which all waypoints are flown.", rich_help_panel=FLIGHT)
]
MinHeightOption = Annotated[
    float | None,
    typer.Option("--min-height", help="Least metres above take-off or ground; by default more than 0.", rich_help_panel=FLIGHT),
]
MaxHeightOption = Annotated[
    float | None,
    typer.Option("--max-height", help="Most metres above take-off or ground; by default 120, the usual limit.", rich_help_panel=FLIGHT),
]
GeoidOption = Annotated[
    float | None,
    typer.Option("--geoid", help="Metres from the WGS84 ellipsoid up to sea level there.", rich_help_panel=FLIGHT),
]
SpeedOption = Annotated[
    float, typer.Option(min=0.1, max=100, help="Metres per second in the air, for flight times and lists.", rich_help_panel=FLIGHT)
]
BatteryOption = Annotated[str, typer.Option(help="Time in the air on one battery, without the reserve.", rich_help_panel=FLIGHT)]
ImageWidthOption = Annotated[
    int | None,
    typer.Option("--image-width-px", min=16, help="Width of the images; by default by EXIF, else of 4:3 or 4000.", rich_help_panel=FLIGHT),
]
ImageHeightOption = Annotated[
    int | None,
    typer.Option("--image-height-px", min=16, help="Their height; by default by EXIF, else of 4:3.", rich_help_panel=FLIGHT),
]
SizeOption = Annotated[str, typer.Option("--size", metavar="WxH", help="Width and height of a picture in px.")]
UpOption = Annotated[str | None, option("sfm.up")]
DistanceOption = Annotated[str | None, option("sfm.distance")]
HeightOption = Annotated[float | None, option("sfm.height_m")]
NorthOption = Annotated[str | None, option("sfm.north")]
GcpOption = Annotated[Path | None, option("sfm.gcp")]
GcpAccuracyOption = Annotated[str | None, option("sfm.gcp_accuracy")]
CheckPointsOption = Annotated[str | None, option("sfm.check_points")]
ContradictionsOption = Annotated[Contradictions, option("sfm.contradictions")]
RequireGridsOption = Annotated[bool, option("sfm.require_grids")]
RequireCrsGridsOption = Annotated[
    bool,
    typer.Option(
        "--require-grids",
        help="Refuse a --crs whose best transformation lacks a grid; by default a warning gives the error in metres.",
        rich_help_panel=COORDINATES,
    ),
]
MatchingOption = Annotated[Matching, option("sfm.matching")]
EffortOption = Annotated[Effort, option("sfm.effort")]
MaskFolder = Annotated[Path | None, option("sfm.masks")]
PosesOption = Annotated[Path | None, option("sfm.poses")]
RefinePosesOption = Annotated[bool, option("sfm.refine_poses")]
MaskIgnoresOption = Annotated[MaskIgnores | None, option("sfm.mask_ignores")]
FilmFramesOption = Annotated[int | None, option("sfm.film_frames")]
PanoramasOption = Annotated[Panoramas | None, option("sfm.panoramas")]
SystemFile = Annotated[Path | None, option("system")]
PlanMethodOption = Annotated[PlanMethod, option("plan.method")]
TrainPresetOption = Annotated[Preset, option("train.preset")]
LongSide = Annotated[int | None, option("train.long_side_px")]
NumSteps = Annotated[int | None, option("train.num_steps")]
MaxSplats = Annotated[int | None, option("train.max_num_splats")]
AggregatePresetOption = Annotated[AggregatePreset, option("aggregate.preset")]
LpipsWeights = Annotated[Path | None, option("evaluate.lpips_weights")]
LpipsNet = Annotated[LpipsNetwork, option("evaluate.lpips_network")]
Seed = Annotated[int, option("seed")]
Verbose = Annotated[
    bool, typer.Option("--verbose", "-v", help="Also print every decision; the report always lists them.", rich_help_panel=OUTPUT)
]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object.", rich_help_panel=OUTPUT)]
Out = Annotated[Path, typer.Option("--out", help="Folder for the result; new or empty.", show_default=False)]
