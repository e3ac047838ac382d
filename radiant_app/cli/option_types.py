"""Options of `radiant plan` about cameras, ground, buffers and privacy, of `radiant bench`, and of sizes, as a command line has them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

GroundOption = Annotated[float | None, typer.Option("--ground", help="Altitude of the ground in the waypoints' metres, else 0.")]
FieldOfViewOption = Annotated[float, typer.Option("--field-of-view", help="Degrees across an image, before capture.")]
BufferOption = Annotated[
    str | None,
    typer.Option("--buffer", help="Capture what a neighbour has too where it sees 20% of this region, or stands within 15m of it."),
]
DeadlineOption = Annotated[float | None, typer.Option("--deadline", min=0, help="Seconds within which an edge takes buffer captures.")]
RasterCellOption = Annotated[
    float | None,
    typer.Option(min=0, help="The cloud plans from counts in cells of so many metres; 0: from positions. Runs by gps, known: 5."),
]
BenchScene = Annotated[
    Path | None,
    typer.Option(
        help="sfm: scene with known cameras; train: photographs, a COLMAP project or a run; methods, paper: 'radiant sfm' or a run."
    ),
]
BenchPlot = Annotated[Path | None, typer.Option(help="train, methods: PNG of the curves.")]
SizeOption = Annotated[str, typer.Option("--size", metavar="WxH", help="Width and height of a picture in px.")]
UpOption = Annotated[
    str | None,
    typer.Option(
        "--up",
        show_default="auto",
        help="auto: by GPS, else by what ground and cameras show. Or: ground (the plane through most points is level), level (photographs "
        "were held level), down (they look straight down), a photograph's name (its top edge is up), or x,y,z in the frame of a COLMAP "
        "project. Goes before GPS.",
    ),
]
DistanceOption = Annotated[
    str | None,
    typer.Option(
        "--distance", metavar="PHOTO,PHOTO,METRES", help="How far apart two photographs were taken: makes lengths metres. Goes before GPS."
    ),
]
HeightOption = Annotated[
    float | None,
    typer.Option("--height", help="Metres of the cameras over the ground that they see, median: makes lengths metres. Goes before GPS."),
]
LongSide = Annotated[int | None, typer.Option("--long-side-px", min=16, help="Long side of the training images.")]
MaskFolder = Annotated[
    Path | None, typer.Option("--masks", help="Folder of masks: photograph.jpg.png or photograph.png, 8-bit grey, 0 is ignored.")
]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object for a machine to read.")]
LpipsWeights = Annotated[
    Path | None,
    typer.Option("--lpips-weights", help="Weights for LPIPS: a folder with torchvision's backbone and lpips' heads, or one safetensors."),
]
LpipsNet = Annotated[Literal["vgg", "alex"], typer.Option("--lpips-net", help="Network of LPIPS: VGG16 or AlexNet.")]
Matching = Literal["auto", "spatial", "exhaustive"]
Out = Annotated[Path, typer.Option("--out", help="Where the result is written; must not exist or be empty.", show_default=False)]
