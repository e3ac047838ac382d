"""Which benchmarks there are, their options, and which of them accepts which option."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Literal, get_args

from radiant_core.choices import CutBy, LpipsNetwork
from radiant_core.errors import BadInput

BenchName = Literal["sfm", "plan", "raster", "train", "methods", "paper", "together", "kinds", "job"]
HeldPart = Literal["interleaved", "line"]
"""interleaved: every eighth photograph; line: a whole line of the flight, the middle one first."""
HoldOut = Literal["interleaved", "line", "both"]
"""both: models without the ones and models without the others, beside each other."""
_ON_MODELS: tuple[BenchName, ...] = ("train", "methods", "paper")
ACCEPTED_BY: Mapping[str, tuple[BenchName, ...]] = {
    "scene": ("sfm", *_ON_MODELS, "together", "job"),
    "threads": ("raster",),
    "presets": ("train",),
    "budgets_s": ("train",),
    "num_seeds": (*_ON_MODELS, "kinds"),
    "num_splits": ("train", "kinds"),
    "num_photographs": ("train", "kinds"),
    "hold_out": ("train", "methods"),
    "off_path": ("train", "methods"),
    "long_side_px": (*_ON_MODELS, "together", "kinds"),
    "num_steps": ("methods", "paper", "kinds"),
    "field_steps": ("methods", "paper"),
    "lpips_weights": ("paper",),
    "lpips_network": ("paper",),
    "ablations": ("train",),
    "plot": ("train", "methods"),
    "methods": ("sfm", *_ON_MODELS, "kinds"),
    "kinds": ("kinds",),
    "layout": ("methods",),
    "num_placements": ("methods",),
    "cut_by": ("methods",),
    "max_gaussians": ("methods",),
    "out": (*_ON_MODELS, "together", "kinds", "job"),
    "baseline": ("sfm", "plan", "raster", "job"),
}
"""Benchmarks by option; an option that is not here is accepted by all."""
_FLAGS = {
    "presets": "--preset",
    "budgets_s": "--budget",
    "num_seeds": "--seeds",
    "num_splits": "--splits",
    "num_photographs": "--photographs",
    "hold_out": "--hold-out",
    "off_path": "--off-path",
    "methods": "--method",
    "kinds": "--kind",
    "num_placements": "--placements",
    "num_steps": "--steps",
    "lpips_network": "--lpips-net",
}
OF_RUN = "run"
"""The layout of a cell that has the plan, the settings and the seed of the run `scene`."""
_OF_A_LAYOUT = ("quick", "num_seeds", "num_placements", "long_side_px", "num_steps", "cut_by", "hold_out")


@dataclass(frozen=True, kw_only=True)
class BenchOptions:
    """Options of all benchmarks."""

    quick: bool = False
    """Fewer and smaller cases."""
    scene: Path | None = None
    """Known cameras (sfm); photographs, a COLMAP project, a folder of `radiant sfm` or a run."""
    threads: int | None = None
    """Threads of the rasterizer; None for all cores."""
    presets: tuple[str, ...] = ()
    """Presets to compare; empty for default and standard."""
    budgets_s: tuple[float, ...] = ()
    """CPU seconds of training; empty for the benchmark's own."""
    num_seeds: int | None = None
    """Models of each kind."""
    num_splits: int = 1
    """How many eighths of the photographs, or lines (train), are held out, one after the other."""
    num_photographs: int | None = None
    """Photographs to train on, evenly chosen, None for all (train); of a scene (kinds)."""
    hold_out: HoldOut = "interleaved"
    """What a split holds out: every eighth photograph, a whole flight line, or either in turn."""
    off_path: Path | None = None
    """Views that were never flown, as the generator writes them."""
    long_side_px: int | None = None
    """Size of the training images."""
    num_steps: int | None = None
    """Steps of a device, the mean of all; None for the benchmark's own."""
    field_steps: int | None = None
    """Steps of a radiance field; None for the benchmark's own."""
    lpips_weights: Path | None = None
    """Weights for LPIPS, as for `radiant evaluate`."""
    lpips_network: LpipsNetwork = "vgg"
    """Network of the weights."""
    ablations: bool = False
    """Whether parts of the training are switched off, one at a time."""
    plot: Path | None = None
    """PNG of the curves."""
    methods: tuple[str, ...] = ()
    """Methods (methods), sections (paper), ablations (train) or helpers (kinds); empty for all."""
    kinds: tuple[str, ...] = ()
    """Kinds of scenes; empty for all."""
    layout: str = "2x2"
    """Edges x devices per edge, or `OF_RUN`."""
    num_placements: int = 1
    """Placements of the edges."""
    cut_by: CutBy = "auto"
    """What regions and strips are cut by, as in a run."""
    max_gaussians: int | None = None
    """Every method's model is reduced to so many."""
    out: Path | None = None
    """Folder of models and rows, from which a later call continues, and of the page (paper)."""
    baseline: Path | None = None
    """File of earlier figures that the new ones must not be worse than."""
    bless: bool = False
    """Whether the new figures replace those in `baseline`."""

    def check(self, name: BenchName) -> None:
        """Raise BadInput where the benchmark does not accept an option or lacks one."""
        for field in fields(self):
            accepted_by = ACCEPTED_BY.get(field.name, get_args(BenchName))
            if getattr(self, field.name) != field.default and name not in accepted_by:
                raise BadInput(f"{_flag(field.name)} is for {', '.join(accepted_by)}, not for {name}: leave it out.")
            if self.layout == OF_RUN and field.name in _OF_A_LAYOUT and getattr(self, field.name) != field.default:
                raise BadInput(f"--layout {OF_RUN} uses the plan and settings of the run: leave out {_flag(field.name)}.")
        if name in ("methods", "paper", "together") and (self.scene is None or self.out is None):
            raise BadInput(f"the benchmark {name} needs --scene, a run or a folder of 'radiant sfm', and --out, a folder for its models.")
        if name in ("kinds", "job") and self.out is None:
            raise BadInput(f"the benchmark {name} needs --out, a folder for its {'scenes, rows and tables' if name == 'kinds' else 'run'}.")
        if self.bless and self.baseline is None:
            raise BadInput("--bless writes the figures into the file of --baseline: name it.")


def _flag(name: str) -> str:
    return _FLAGS.get(name, "--" + name.replace("_", "-"))
