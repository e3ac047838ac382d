"""Closed choices of a user, shared by the command line, files and the code. Imports nothing."""

from __future__ import annotations

from typing import Literal

Effort = Literal["auto", "thorough"]
"""auto: OpenCV's features, the pairs alone that a preview finds promising, few adjustments of all
photographs, and thorough where over a tenth stays unregistered; thorough: COLMAP's features, all
pairs of neighbours, and COLMAP's adjustments."""
Contradictions = Literal["stop", "warn"]
"""Where what a user says of place, scale or north and the photographs' GPS differ by more than GPS
can. stop: nothing is made; warn: what the user says is taken."""
Matching = Literal["auto", "spatial", "exhaustive"]
"""auto: spatial where at least nine in ten photographs have GPS, else exhaustive; spatial: each
with its GPS neighbours; exhaustive: every pair."""
MaskIgnores = Literal["black", "white", "nothing"]
"""Which colour of a mask leaves pixels out; nothing: no mask is used."""
Panoramas = Literal["all", "none"]
"""Which photographs are equirectangular panoramas, where their XMP does not say it rightly."""
PlanMethod = Literal["exact", "paper", "paper-literal", "even"]
"""exact: least makespan; paper: the paper's Alg. 1 on power cells; paper-literal: Alg. 1 as
written, with half-planes; even: equal counts per device."""
CutBy = Literal["auto", "positions", "looks"]
"""positions: regions and strips are cut where cameras stand; looks: where they look; auto: where
they look if that makes strips hold clearly more of what their own devices see."""
DevicesUsed = Literal["auto", "all"]
"""auto: as many devices as one owner's photographs are worth, the fastest; all: every one of the
system. A number of devices is what this machine is divided into where there is no system."""
TrainedAs = Literal["auto", "together", "joined"]
"""together: machines train one model and add up gradients in every step; joined: each trains a
model of its own, and these are joined; auto: by the predicted times of both."""
StepFormat = Literal["float32", "bfloat16", "blocks"]
"""How gradients travel between machines that train together (`train/together/codec.py`)."""
StepPolicy = Literal["per_photograph", "fixed"]
"""per_photograph: a device's steps follow its photographs, so that all together take as many as
with a fixed number each; fixed: every device takes the same number."""
UploadFormat = Literal["float32", "float16", "spz"]
"""float32: exact; float16: half the bytes, centres in 21 bits; spz: about a fifth, by Open3D."""
LpipsNetwork = Literal["vgg", "alex"]
"""Backbone of LPIPS: VGG16 or AlexNet."""
ExportFormat = Literal[
    "ply", "spz", "sog", "usd", "lod", "tiles", "viewer", "geojson", "colmap", "nerfstudio",
    "mesh", "dsm", "dtm", "ortho", "contours", "laz", "glb",
]  # fmt: skip
"""ply, spz, sog, usd: a model; lod, tiles: with levels of detail (streamed SOG, 3D Tiles); viewer:
with a page to fly through it; geojson: regions and cameras; colmap, nerfstudio: a project for other
trainers; mesh: the surface; dsm: heights of the surface, dtm: without buildings and trees; ortho:
the scene from straight above; contours: lines of equal height; laz: points of the surface; glb: a
textured mesh."""
TileContent = Literal["spz", "plain"]
"""Of 3D Tiles. spz: compressed, as CesiumJS draws them; plain: attributes of float32, as glTF's
extension for Gaussians alone has them."""
GzipSpzVersion = Literal[2, 3]
"""2: rotations of 3 bytes; 3: of 4, more exact. Both are compressed by gzip."""
SpzVersion = Literal[2, 3, 4]
"""As before; 4: compressed by Zstandard, by Open3D."""
MeasureKind = Literal["distance", "height", "area", "volume", "profile"]
"""What is measured on a surface."""
Trajectory = Literal["orbit", "border"]
"""orbit: once around the scene; border: along a border of two edges."""
View = Literal["regions", "cameras", "seams", "splats", "compare"]
"""What the picture of a run shows."""
Viewer = Literal["radiant", "open3d"]
"""radiant: our own window and pictures; open3d: Open3D's, with the same layers."""
Painter = Literal["radiant", "vtk", "open3d"]
"""Of the model in the window. radiant: our renderer; vtk: VTK's Gaussians; open3d: Open3D's scene;
by default ours, unless a graphics card makes another faster."""
LightMode = Literal["auto", "none", "always"]
"""auto: the light of photographs is modelled where it differs; none, always: never or anyhow."""
Heights = Literal["takeoff", "absolute"]
"""Of flight lists. takeoff: above where the drone took off; absolute: above sea or ellipsoid."""
HeightFrom = Literal["takeoff", "ground", "sea", "ellipsoid", "absolute", "unknown"]
"""What a waypoint's height counts from. takeoff: where the drone took off; ground: the ground below
that very waypoint; sea: mean sea level; ellipsoid: that of WGS84; absolute: one of these two, and
nothing says which; unknown: it has no height, whatever number stands there."""
Version = Literal["refined", "joined", "cut"]
"""Of a scene: after the devices' photographs; as the cloud made it; the edges' models cut at their
borders."""
