"""The sections of `radiant bench paper` that compare models: their figures, tables and pictures.

    main      every method there is here, on one layout; `fed3dgs` adds that one to its table
    border    one border as the cut, `paper` and ours show it
    regions   merge against retrain on 2, 4 and 8 regions of devices, beside the borders' length
    epochs    quality beside borders and elsewhere against the epochs of retraining at both tiers
    fusion    cut at both tiers, retrain at edges alone, at the cloud alone, at both; two systems
    balance   even against balanced regions with the time of each device (`paper_balance.py`)

An arm that several sections show is made once (`arms.py`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.methods.arms import Arm, ArmRow, Arms
from benchmarks.methods.bench import METHODS, curves_of, epochs_arm
from benchmarks.methods.cells import DEVICE_SPEEDS, Cell, Layout
from benchmarks.methods.seam_error import MIN_IMAGES
from benchmarks.methods.together import TOGETHER
from benchmarks.tracking import track_items
from radiant_core.evaluate.image_error import psnr_db
from radiant_core.numerics import FloatArray
from radiant_core.plan.borders.borders import shared_borders
from radiant_core.plan.plans import CloudPlan, EdgePlan

if TYPE_CHECKING:
    from benchmarks.charts.line_chart import Panel
    from radiant_viewer.pictures.images import Image

EPOCHS, QUICK_EPOCHS = (0, 1, 2, 5, 10), (0, 1, 2)
LAYOUTS = (Layout(num_edges=2, num_devices=1), Layout(num_edges=2, num_devices=2), Layout(num_edges=4, num_devices=2))
SECOND_SYSTEM = (Layout(num_edges=3, num_devices=2), (1.0, 0.4))
QUICK_SECOND_SYSTEM = (Layout(num_edges=1, num_devices=2), (1.0, 0.4))
WINDOW_SHARE = 0.45
"""Of the photograph's width and height, in the picture of a border."""
_GROUPS = tuple(arm.name for arm in TOGETHER)
"""Not of the paper's table: nothing is joined in the one, and the other is between both."""
REGION_METHODS = ("crop", "paper", "ours")
NAMES = {
    "crop": "cut",
    "ours edges": "ours, the cloud cuts",
    "even": "even, then ours",
    "photographs": "retrained on photographs",
    "vastgaussian": "VastGaussian",
    "fed3dgs": "Fed3DGS",
}
"""Names of methods on the page where the key is not clear."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Part:
    """A section of the page: Markdown below its title, pictures by file name, figures for JSON."""

    title: str
    text: str
    pictures: Mapping[str, Image] = field(default_factory=dict)
    figures: Any = None


def main_part(arms: Arms, seeds: Sequence[int], quick: bool) -> Part:
    """All methods but Fed3DGS."""
    del quick
    return _main_table(arms, seeds, [name for name in METHODS if name not in ("ours edges", "fed3dgs", *_GROUPS)])


def fed3dgs_part(arms: Arms, seeds: Sequence[int], quick: bool) -> Part:
    """The same with Fed3DGS, which takes twice the time of any other; a quick run omits it."""
    return (
        main_part(arms, seeds, quick)
        if quick
        else _main_table(arms, seeds, [name for name in METHODS if name not in ("ours edges", *_GROUPS)])
    )


def _main_table(arms: Arms, seeds: Sequence[int], methods: Sequence[str]) -> Part:
    from benchmarks.charts.curve_chart import curve_picture

    rows = _rows(arms, [(arms.cell(arms.layout, seed), METHODS[name]) for name in methods for seed in seeds], "main")
    lines = ["| method | PSNR dB | SSIM | Gaussians | CPU s | training Mpx |", "|---|---|---|---|---|---|"]
    for name in methods:
        arm_rows = [row for row in rows if row.arm == name]
        lines.append(
            f"| {_label(name)} | {_mean(arm_rows, 'mean_psnr_db'):.2f} | {_mean(arm_rows, 'mean_ssim'):.3f} |"
            f" {_mean(arm_rows, 'num_gaussians'):,.0f} | {_mean(arm_rows, 'cpu_s'):.0f} | {_mean(arm_rows, 'training_px') / 1e6:.0f} |"
        )
    devices = [model.summary for seed in seeds for model in arms.cell(arms.layout, seed).devices.values()]
    cpu_s, pixels = (sum(summary[name] for summary in devices) / len(seeds) for name in ("cpu_s", "training_px"))
    lines += [
        "",
        f"Seconds and pixels come on top of the devices' trainings, {cpu_s:.0f} s and {pixels / 1e6:.0f} Mpx, which all methods but the",
        "centralised model and VastGaussian share; those two train models of their own, which are counted.",
    ]
    curves = {_label(name): points for name, points in curves_of(rows).items()}
    picture = curve_picture(curves, "Every method on the same devices' models", _data(arms), "CPU time after the devices' trainings (s)")
    return Part(title="Main table", text="\n".join(lines), pictures={"main.png": picture}, figures=_records(rows))


def regions_part(arms: Arms, seeds: Sequence[int], quick: bool) -> Part:
    """Cost and quality of joining against the number of regions."""
    from benchmarks.charts.line_chart import line_picture

    layouts = LAYOUTS[:2] if quick else LAYOUTS
    cells = {layout: [arms.cell(layout, seed) for seed in seeds] for layout in layouts}
    jobs = [(cell, METHODS[name]) for layout in layouts for cell in cells[layout] for name in REGION_METHODS]
    rows = _rows(arms, jobs, "regions")
    lengths_m = {
        layout: border_length_m(cells_of_layout[0].recipe.cloud_plan, cells_of_layout[0].recipe.edge_plans)
        for layout, cells_of_layout in cells.items()
    }
    lines = ["| layout | regions | borders m | method | PSNR dB | SSIM | CPU s | training Mpx |", "|---|---|---|---|---|---|---|---|"]
    table: dict[str, list[tuple[float, float, float, float]]] = {name: [] for name in REGION_METHODS}
    for layout in layouts:
        names = {cell.name for cell in cells[layout]}
        for name in REGION_METHODS:
            arm_rows = [row for row in rows if row.arm == name and row.cell in names]
            psnr, cpu_s, pixels = (_mean(arm_rows, figure) for figure in ("mean_psnr_db", "cpu_s", "training_px"))
            table[name].append((_regions(layout), psnr, cpu_s, pixels / 1e6))
            lines.append(
                f"| {layout} | {_regions(layout)} | {lengths_m[layout]:.0f} | {_label(name)} | {psnr:.2f} |"
                f" {_mean(arm_rows, 'mean_ssim'):.3f} | {cpu_s:.1f} | {pixels / 1e6:.0f} |"
            )
    picture = line_picture(
        _region_panels(table, list(lengths_m.values())), "Merge against retrain as regions grow", _data(arms), panel_wh=(400, 330)
    )
    lines += [
        "",
        "Borders are all lines between regions of devices inside the plan's outline. The devices' trainings are not in the seconds.",
    ]
    figures = {"rows": _records(rows), "border_length_m": {str(layout): length_m for layout, length_m in lengths_m.items()}}
    return Part(title="Merge against retrain as regions grow", text="\n".join(lines), pictures={"regions.png": picture}, figures=figures)


def _region_panels(table: Mapping[str, list[tuple[float, float, float, float]]], lengths_m: Sequence[float]) -> list[Panel]:
    from benchmarks.charts.line_chart import Line, Panel

    columns = {name: np.array(values, float) for name, values in table.items()}
    counts = columns["crop"][:, 0]
    retrained = {name: values for name, values in columns.items() if values[0, 3] > 0}
    psnr = np.concatenate([values[:, 1] for values in columns.values()])
    x = {"x_label": "Regions of devices", "x_ticks": tuple(counts.tolist())}
    length = Line(name="length of all borders", x=counts, y=np.array(lengths_m) / lengths_m[0], marked=True, style=len(REGION_METHODS))
    growth = [
        Line(name=_label(name), x=counts, y=values[:, 3] / values[0, 3], marked=True, style=REGION_METHODS.index(name))
        for name, values in retrained.items()
    ]
    quality = [Line(name=_label(name), x=counts, y=values[:, 1], marked=True) for name, values in columns.items()]
    seconds = [Line(name=_label(name), x=counts, y=values[:, 2], marked=True) for name, values in columns.items()]
    return [
        Panel(lines=tuple(quality), y_label="PSNR of held-out photographs (dB)", y_range=_span_around(psnr), **x),
        Panel(lines=tuple(seconds), y_label="Joining (CPU s)", **x),
        Panel(lines=(*growth, length), y_label="Training pixels and borders ÷ those of 2 regions", **x),
    ]


def epochs_part(arms: Arms, seeds: Sequence[int], quick: bool) -> Part:
    """Quality in band and interior against epochs; of whole photographs if bands are too small."""
    from benchmarks.charts.line_chart import line_picture

    epochs = QUICK_EPOCHS if quick else EPOCHS
    jobs = {(name, count): epochs_arm(name, count) for name in ("ours", "paper") for count in epochs}
    rows = _rows(arms, [(arms.cell(arms.layout, seed), arm) for arm in jobs.values() for seed in seeds], "epochs")
    of = {key: [row for row in rows if row.arm == arm.name] for key, arm in jobs.items()}
    lines = ["| epochs | method | band dB | interior dB | whole dB | CPU s |", "|---|---|---|---|---|---|"]
    for (name, count), rows_of_count in of.items():
        texts = [_mean_text(rows_of_count, figure) for figure in ("band_db", "interior_db")]
        lines.append(
            f"| {count} | {name} | {' | '.join(texts)} | {_mean(rows_of_count, 'mean_psnr_db'):.2f} | {_mean(rows_of_count, 'cpu_s'):.0f} |"
        )
    lines += [
        "",
        "No epochs: the plain cut at the devices' strips, for both. `paper` retrains for so many at its edges and for as many again at the"
        " cloud, `ours` at the cloud alone.",
    ]
    is_measured = all(row.band_db is not None and row.interior_db is not None for row in rows)
    if not is_measured:
        num_images = min(row.num_band_images for row in rows)
        lines.append(f"Band and interior are insufficient: borders lie in {num_images} held-out photographs, {MIN_IMAGES} are asked for.")
    kinds = (
        {"band_db": "Beside borders: PSNR (dB)", "interior_db": "Elsewhere: PSNR (dB)"} if is_measured else {"mean_psnr_db": "PSNR (dB)"}
    )
    picture = line_picture(_epoch_panels(of, epochs, kinds), "Quality against epochs of retraining", _data(arms), panel_wh=(430, 330))
    title = "Border quality against epochs of retraining"
    return Part(title=title, text="\n".join(lines), pictures={"epochs.png": picture}, figures=_records(rows))


def _epoch_panels(of: Mapping[tuple[str, int], list[ArmRow]], epochs: Sequence[int], kinds: Mapping[str, str]) -> list[Panel]:
    from benchmarks.charts.line_chart import Line, Panel

    values = {kind: {name: np.array([_mean(of[name, count], kind) for count in epochs]) for name in ("ours", "paper")} for kind in kinds}
    span = _span_around(np.concatenate([line for lines in values.values() for line in lines.values()]))
    xs = np.array(epochs, float)
    return [
        Panel(
            lines=tuple(
                Line(name=name, x=xs, y=line, marked=True, style=REGION_METHODS.index(name)) for name, line in values[kind].items()
            ),
            x_label="Epochs at the edges and at the cloud",
            y_label=label,
            y_range=span,
            x_ticks=tuple(xs.tolist()),
        )
        for kind, label in kinds.items()
    ]


def fusion_part(arms: Arms, seeds: Sequence[int], quick: bool) -> Part:
    """Retraining at the edges, at the cloud, or at both, on two systems."""
    systems = ((arms.layout, DEVICE_SPEEDS), QUICK_SECOND_SYSTEM if quick else SECOND_SYSTEM)
    settings = {
        "crop": "cut at both",
        "ours edges": "retrain at the edges, cut at the cloud",
        "ours": "retrain at the edges, then at the cloud",
        "paper": "retrain at both, as `paper`",
    }
    cells = {system: [arms.cell(system[0], seed, system[1]) for seed in seeds] for system in systems}
    jobs = [(cell, METHODS[name]) for cells_of_layout in cells.values() for cell in cells_of_layout for name in settings]
    rows = _rows(arms, jobs, "fusion")
    lines = ["| system | joining | PSNR dB | SSIM | Gaussians | CPU s |", "|---|---|---|---|---|---|"]
    for number, ((layout, speeds), own_cells) in enumerate(cells.items(), 1):
        names = {cell.name for cell in own_cells}
        for name, setting in settings.items():
            arm_rows = [row for row in rows if row.arm == name and row.cell in names]
            lines.append(
                f"| {number}: {_system(layout, speeds)} | {setting} | {_mean(arm_rows, 'mean_psnr_db'):.2f} |"
                f" {_mean(arm_rows, 'mean_ssim'):.3f} | {_mean(arm_rows, 'num_gaussians'):,.0f} | {_mean(arm_rows, 'cpu_s'):.0f} |"
            )
    return Part(title="Fusion: which tier retrains", text="\n".join(lines), figures=_records(rows))


def border_part(arms: Arms, seeds: Sequence[int], quick: bool) -> Part:
    """The place at a border where the plain cut falls most behind the centralised model, rendered
    by each method."""
    from benchmarks.charts.healing_chart import Healed, healing_picture

    del quick
    cell, title = arms.cell(arms.layout, seeds[0]), "A border, cut and healed"
    bands = [mask.band for mask in arms.masks(cell)]
    if not any(band.any() for band in bands):
        return Part(title=title, text="No held-out photograph sees a border.")
    views = {name: arms.views(cell, METHODS[name]) for name in track_items(("centralised", *REGION_METHODS), "bench paper, border")}
    images = zip(views["crop"], views["centralised"], arms.photographs, strict=True)
    excess = [((cut.image - photograph) ** 2 - (whole.image - photograph) ** 2).sum(axis=2) for cut, whole, photograph in images]
    index, place = _worst_window([error * band for error, band in zip(excess, bands, strict=True)])
    photograph = arms.photographs[index][place]
    healed = [
        Healed(caption=f"{_label(name)}: {psnr_db(view[index].image[place], photograph):.1f} dB here", image=view[index].image_bytes[place])
        for name, view in views.items()
    ]
    name = arms.scene.held_out_views.cameras.names[index]
    detail = f"{_data(arms)}; held-out photograph {name}, where the cut is most behind the centralised model beside a border"
    picture = healing_picture((photograph * 255).round().astype(np.uint8), bands[index][place], healed, title, detail)
    text = f"Photograph {name}, held out of everything, where beside a border the cut is most behind the centralised model."
    figures = {"photograph": name, "captions": [one.caption for one in healed]}
    return Part(title=title, text=text, pictures={"border.png": picture}, figures=figures)


def _worst_window(errors: Sequence[NDArray[np.floating]]) -> tuple[int, tuple[slice, slice]]:
    """Index of the image (H,W) of errors and its window whose middle half has the largest sum."""
    best, window = -np.inf, (0, (slice(None), slice(None)))
    for index, error in enumerate(errors):
        size = [max(1, round(WINDOW_SHARE * side)) for side in error.shape]
        inner = [max(1, side // 2) for side in size]
        total = np.pad(error.astype(np.float64).cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
        height, width = inner
        sums = total[height:, width:] - total[:-height, width:] - total[height:, :-width] + total[:-height, :-width]
        corner = np.unravel_index(int(sums.argmax()), sums.shape)
        if sums[corner] > best:
            starts = [
                int(np.clip(place - (full - half) // 2, 0, side - full))
                for place, half, full, side in zip(corner, inner, size, error.shape, strict=True)
            ]
            rows, columns = (slice(start, start + full) for start, full in zip(starts, size, strict=True))
            best, window = float(sums[corner]), (index, (rows, columns))
    return window


def border_length_m(plan: CloudPlan, edge_plans: Sequence[EdgePlan]) -> float:
    """Metres of the borders between edges and between devices of one edge, inside the outline."""
    between_edges = sum(border.length_m for border in shared_borders(plan))
    # A cut is part of the outlines of two strips, the region's outline of one.
    cuts = sum(
        sum(_perimeter_m(strip) for strip in edge_plan.strips) - _perimeter_m(region)
        for region, edge_plan in zip(plan.borders, edge_plans, strict=True)
        if any(len(strip) for strip in edge_plan.strips)
    )
    return between_edges + max(cuts, 0.0) / 2


def _perimeter_m(polygon: FloatArray) -> float:
    return float(np.linalg.norm(np.roll(polygon, -1, axis=0) - polygon, axis=1).sum())


def _rows(arms: Arms, jobs: Sequence[tuple[Cell, Arm]], part: str) -> list[ArmRow]:
    rows = [arms.row(cell, arm) for cell, arm in track_items(jobs, f"bench paper, {part}")]
    return list({(row.cell, row.arm): row for row in rows}.values())


def _mean(rows: Sequence[ArmRow], figure: str) -> float:
    return float(np.mean([getattr(row, figure) for row in rows]))


def _mean_text(rows: Sequence[ArmRow], figure: str) -> str:
    return "insufficient" if any(getattr(row, figure) is None for row in rows) else f"{_mean(rows, figure):.2f}"


def _span_around(values: FloatArray) -> tuple[float, float]:
    low, high = float(values.min()), float(values.max())
    margin = max(0.08 * (high - low), 0.05)
    return low - margin, high + margin


def _label(method: str) -> str:
    return NAMES.get(method, method)


def _regions(layout: Layout) -> int:
    return layout.num_edges * layout.num_devices


def _system(layout: Layout, speeds: Sequence[float]) -> str:
    edges = f"{layout.num_edges} edges" if layout.num_edges > 1 else "1 edge"
    return f"{edges} × {layout.num_devices} devices of speeds {' and '.join(f'{speed:g}' for speed in speeds)}"


def _data(arms: Arms) -> str:
    return f"{arms.scene.name}, {arms.scene.long_side_px} px, {arms.num_steps} steps per device"


def _records(rows: Sequence[ArmRow]) -> list[dict[str, Any]]:
    return [asdict(row) for row in rows]
