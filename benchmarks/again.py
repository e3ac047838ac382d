"""Does a second flight pay where it was proposed? Run as
`PYTHONPATH=sample_scenes python -m benchmarks.again --out OUT`.

For each seed a town of the generator, its truth known: 26 photographs of a cheap nadir flight, of
which every eighth is held out, make a model; its map proposes 13 more views. Three trainings of all
26 and 13 more, as many steps each: as proposed, on another nadir grid, and drawn at random from the
same safe views. All are scored on the same views, off the path too; holes are true surface in these
views that no photograph shows. With `--flight street` or `orbit` the first are a walk along
a street or a flight around a block, and so is "grid". Rows lie in OUT as soon as they are measured;
a later call resumes.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.evaluate.bootstrap import paired_bootstrap
from radiant_core.evaluate.image_error import psnr_db
from radiant_core.evaluate.split import held_out_mask
from radiant_core.frames import Frame
from radiant_core.hierarchy.device import fit_prepared, prepare_training
from radiant_core.hierarchy.messages import DeviceTask
from radiant_core.hierarchy.reporter import Recorder
from radiant_core.io.colmap.model import read_model
from radiant_core.io.run_store import read_json, write_json
from radiant_core.next_flight.candidates import FlightRules, air_over, candidate_views, usual_take_off
from radiant_core.next_flight.choosing import COMPARED_FACETS, choose_views
from radiant_core.next_flight.model_surface import MapView, facets_of_model
from radiant_core.next_flight.predicted_error import (
    TrainingErrors,
    error_samples,
    errors_in_views,
    fit_errors,
    mean_errors_db,
    rank_correlation,
)
from radiant_core.next_flight.sightings import Knowledge, Sighting, Sights, known_by
from radiant_core.numerics import FloatArray
from radiant_core.render.backends import resolve_backend
from radiant_core.render.rendered_view import render_views
from radiant_core.render.trajectories import Lens
from radiant_core.scene import SfmScene
from radiant_core.sfm.world_frame.world import scene_as_given
from radiant_core.splats import Splats
from radiant_core.survey.map_grid import grid_over, map_frame_of
from radiant_core.survey.seen_ground import seen_ground
from radiant_core.train.config import train_preset
from radiant_core.train.needs import Overrides, fit_to_backend
from radiant_core.train.views import TrainingViews
from scenegen.config import SceneConfig
from scenegen.flight import Shot, plan_flight
from scenegen.known_model import write_known_model
from scenegen.off_path import count_views, plan_off_path
from scenegen.raycast import Photographer

ARMS = ("proposed", "grid", "random")
NUM_FLOWN, NUM_MORE, NUM_OFF_PATH, NUM_ON_PATH = 26, 13, 24, 12
EXTENT_M, SAFE_M, CELL_GSD = (100.0, 70.0), 5.0, 3.0
RAISED_M, TURNED_DOWN_DEG = 3.0, 15.0
ON_PATH = "on_"
"""How the names of scored views like those flown begin."""
PLAIN = {"light": "none", "sky": False, "fill_in": False}
"""Light is the generator's, equal in all photographs, and nothing is left to trials."""
app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)


@dataclass(frozen=True, kw_only=True)
class ArmRow:
    """One training: PSNR per view, share of true surface that no photograph shows, least distance
    of the new photographs to the true surface, CPU seconds."""

    seed: int
    arm: str
    psnr_db: tuple[float, ...]
    holes: float
    clearance_m: float
    cpu_s: float


@dataclass(frozen=True, kw_only=True)
class MapRow:
    """Of one map: rank correlation of predicted and true error over facets, and the share of them
    at least as good as called, in new views like those flown and off their path; the same
    correlation by held-out photographs, which may show too few facets for any; CPU seconds of map
    and proposal."""

    seed: int
    rank_on_path: float | None
    rank_off_path: float | None
    rank_held_out: float | None
    good_on_path: float | None
    good_off_path: float | None
    facets: int
    map_s: float
    proposal_s: float


class Town:
    """One seed's town, its flight and what all models are scored on."""

    def __init__(self, seed: int, width_px: int, num_steps: int, flight: str = "survey") -> None:
        self.config = SceneConfig(
            flight=flight,
            num_cameras=NUM_FLOWN,
            extent_m=EXTENT_M,
            oblique_fraction=0.0,
            gps_error_m=0.0,
            seed=seed,
            off_path=NUM_OFF_PATH if flight == "survey" else 0,
            textured_points=True,
            num_known_points=6000,
            width_px=width_px,
            height_px=round(0.75 * width_px),
        )
        self.seed, self.num_steps = seed, num_steps
        self.photographer = Photographer(self.config)
        self.flown = plan_flight(self.config)
        on_path = plan_flight(replace(self.config, num_cameras=NUM_ON_PATH, date=2))
        self.scored = [*self.off_path(), *(replace(shot, name=f"{ON_PATH}{shot.name}") for shot in on_path)]
        self.truths = [self.photograph(shot) for shot in self.scored]
        self.depths = [self.photographer.depth(shot) for shot in self.scored]

    def off_path(self) -> list[Shot]:
        """Views that the flight does not take: of a survey the generator's, of a street or an orbit
        those of a third date, higher and turned down."""
        if self.config.flight == "survey":
            return plan_off_path(self.config, self.photographer)
        return [raised(shot) for shot in plan_flight(replace(self.config, num_cameras=NUM_OFF_PATH, date=3))]

    def photograph(self, shot: Shot) -> NDArray[np.uint8]:
        """What the shot shows, in even light."""
        return self.photographer.photograph(replace(shot, exposure_ev=0.0, time_s=0.0), 0)

    def scene(self, shots: Sequence[Shot]) -> SfmScene:
        """Exact cameras, and points that two of the shots see."""
        with TemporaryDirectory() as folder:
            write_known_model(Path(folder), self.photographer, list(shots))
            frame = Frame(kind="metric", origin_lat_lon_alt=np.array([47.37, 8.54, 400.0]))
            return scene_as_given(read_model(Path(folder)), frame).scene

    def train(self, scene: SfmScene, images: Sequence[NDArray[np.uint8]], rows: NDArray[np.int64]) -> Splats:
        """A model of the photographs `rows` of the scene."""
        backend = resolve_backend("auto")
        overrides = Overrides(num_steps=self.num_steps, long_side_px=self.config.width_px, settings=PLAIN)
        config, _ = fit_to_backend(replace(train_preset("default"), seed=self.seed), backend, overrides)
        task = DeviceTask(scene=scene.restricted_to(rows), train=config, backend=backend)
        views = TrainingViews(cameras=scene.cameras.select(rows), images=tuple(images[row] for row in rows))
        recorder = Recorder(stage="train")
        return fit_prepared(prepare_training(task, views, recorder), recorder).splats

    def scored_cameras(self) -> Cameras:
        """The cameras of the scored views."""
        return _cameras_of(self.config, self.scored)

    def score(self, splats: Splats) -> tuple[float, ...]:
        """PSNR of each scored view."""
        views = render_views(splats, self.scored_cameras())
        return tuple(psnr_db(view.image, truth / 255) for view, truth in zip(views, self.truths, strict=True))

    def holes(self, shots: Sequence[Shot]) -> float:
        """Share of the true surface in the scored views that none of the shots shows."""
        num_shown = total = 0
        for shot, depth in zip(self.scored, self.depths, strict=True):
            near = depth < 3 * self.config.altitude_m
            num_shown += int((count_views(self.photographer, shot, depth, list(shots))[near] > 0).sum())
            total += int(near.sum())
        return 1 - num_shown / total


def raised(shot: Shot) -> Shot:
    """The shot from `RAISED_M` higher, turned down by `TURNED_DOWN_DEG`."""
    angle = np.radians(TURNED_DOWN_DEG)
    turn = np.array([[1.0, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]])
    pose = np.eye(4)
    pose[:3, :3] = turn @ shot.cam_from_world[:3, :3]
    pose[:3, 3] = -pose[:3, :3] @ (shot.center_m + np.array([0, 0, RAISED_M]))
    return replace(shot, cam_from_world=pose)


def _cameras_of(config: SceneConfig, shots: Sequence[Shot]) -> Cameras:
    K = np.array([[config.focal_px, 0, config.width_px / 2], [0, config.focal_px, config.height_px / 2], [0, 0, 1]])
    return Cameras(
        names=tuple(shot.name for shot in shots),
        Ks=np.tile(K, (len(shots), 1, 1)),
        cam_from_world=np.array([shot.cam_from_world for shot in shots]),
        sizes_wh=np.tile([config.width_px, config.height_px], (len(shots), 1)),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Proposals:
    """The new shots of each arm, and figures of the map that they come from."""

    shots: dict[str, list[Shot]]
    row: MapRow


def propose(town: Town) -> Proposals:
    """Train on the flight, map what is known, and propose each arm's shots."""
    scene, images = town.scene(town.flown), [town.photograph(shot) for shot in town.flown]
    held_out = held_out_mask(scene.cameras.names)
    rows = np.flatnonzero(~held_out)
    splats = town.train(scene, images, rows)
    begun_s = time.process_time()
    map_frame = map_frame_of(scene.frame)
    ground = seen_ground(scene, map_frame)
    grid = grid_over(ground.low, ground.high, CELL_GSD * ground.gsd, map_frame)
    facets = facets_of_model(splats, scene, ground, grid, MapView(map_frame=map_frame, long_side_px=town.config.width_px))
    sights, cameras = Sights(facets, map_frame), scene.cameras.select(rows)
    sightings = sights.all_of(cameras)
    known_facets = known_by(sights, cameras, sightings)
    row = _map_row(town, sights, known_facets, sightings, splats, (scene, images, held_out))
    map_s = time.process_time() - begun_s
    lens = Lens(
        size_wh=(town.config.width_px, town.config.height_px),
        field_of_view_deg=float(np.degrees(2 * np.arctan(town.config.width_px / 2 / town.config.focal_px))),
    )
    begun_s = time.process_time()
    air = air_over(facets, FlightRules(safe=SAFE_M, take_off=usual_take_off(facets), lowest=SAFE_M))
    candidates = candidate_views(air, map_frame, lens, ground.reach)
    sample = facets.sample(COMPARED_FACETS)
    compared = Sights(sample, map_frame)
    flown = compared.all_of(cameras)
    chosen = choose_views(sample, known_by(compared, cameras, flown), flown, compared.all_of(candidates.cameras), NUM_MORE)
    proposal_s = time.process_time() - begun_s
    random_rows = np.random.default_rng([town.seed, 66]).choice(len(candidates), NUM_MORE, replace=False)
    grid_flight = plan_flight(replace(town.config, num_cameras=NUM_MORE, date=1))
    shots = {
        "proposed": _shots(candidates.cameras, [view.row for view in chosen]),
        "random": _shots(candidates.cameras, random_rows.tolist()),
        "grid": [replace(shot, name=f"more_{number:04d}.jpg") for number, shot in enumerate(grid_flight)],
    }
    return Proposals(shots=shots, row=replace(row, map_s=map_s, proposal_s=proposal_s))


def _shots(cameras: Cameras, rows: Sequence[int]) -> list[Shot]:
    return [
        Shot(
            name=f"more_{number:04d}.jpg",
            cam_from_world=cameras.cam_from_world[row],
            gps_position_m=cameras.centers[row],
            time_s=0.0,
            exposure_ev=0.0,
        )
        for number, row in enumerate(rows)
    ]


def _map_row(
    town: Town,
    sights: Sights,
    known_facets: Knowledge,
    sightings: Sequence[Sighting],
    splats: Splats,
    flown: tuple[SfmScene, Sequence[NDArray[np.uint8]], NDArray[np.bool_]],
) -> MapRow:
    """Predicted error by held-out photographs against the true one in the scored views."""
    scene, images, held_out = flown
    cell, count = sights.facets.surface.grid.cell, len(sights.facets)

    def errors(cameras: Cameras, pictures: Sequence[NDArray[np.uint8]], sightings: Sequence[Sighting]) -> list[FloatArray]:
        return list(errors_in_views(splats, cameras, pictures.__getitem__, sightings, cell))

    train_rows, held_rows = np.flatnonzero(~held_out), np.flatnonzero(held_out)
    train = TrainingErrors(
        count, sightings, errors(scene.cameras.select(train_rows), [images[row] for row in train_rows.tolist()], sightings)
    )
    held_cameras = scene.cameras.select(held_rows)
    held_seen = sights.all_of(held_cameras)
    samples = error_samples(
        train, known_facets.score, held_seen, errors(held_cameras, [images[row] for row in held_rows.tolist()], held_seen)
    )
    row = MapRow(
        seed=town.seed, rank_on_path=None, rank_off_path=None, rank_held_out=None, good_on_path=None,
        good_off_path=None, facets=count, map_s=0.0, proposal_s=0.0,
    )  # fmt: skip
    try:
        model = fit_errors(samples)
    except BadInput as error:
        print(f"seed {town.seed}: errors are not predicted: {error}", file=sys.stderr)
        return row
    predicted_db = model.predict(train.typical_db(), known_facets.score)
    scored = town.scored_cameras()
    seen_scored = sights.all_of(scored)
    errors_scored = errors(scored, town.truths, seen_scored)

    def held_against(*, on_path: bool) -> tuple[float, float | None]:
        rows = [row for row, shot in enumerate(town.scored) if shot.name.startswith(ON_PATH) == on_path]
        true_db = mean_errors_db(count, [seen_scored[row] for row in rows], [errors_scored[row] for row in rows])
        both = np.isfinite(predicted_db) & np.isfinite(true_db)
        good = None if model.margin_db is None else float((true_db[both] >= predicted_db[both] - model.margin_db).mean())
        return rank_correlation(predicted_db[both], true_db[both]), good

    rank_on, good_on = held_against(on_path=True)
    rank_off, good_off = held_against(on_path=False)
    return replace(
        row, rank_on_path=rank_on, rank_off_path=rank_off, rank_held_out=model.rank, good_on_path=good_on, good_off_path=good_off
    )


def measure_seed(seed: int, out: Path, width_px: int, num_steps: int, flight: str = "survey") -> tuple[list[ArmRow], MapRow]:
    """The rows of a seed, measured where they are not there yet."""
    folder = out / f"{flight}-{width_px}px-{num_steps}" / f"seed-{seed}"
    folder.mkdir(parents=True, exist_ok=True)
    paths = {arm: folder / f"{arm}.json" for arm in (*ARMS, "map")}
    if not all(path.is_file() for path in paths.values()):
        town = Town(seed, width_px, num_steps, flight)
        proposals = propose(town)
        write_json(paths["map"], asdict(proposals.row))
        for arm in ARMS:
            if paths[arm].is_file():
                continue
            begun_s = time.process_time()
            shots = [*town.flown, *proposals.shots[arm]]
            scene = town.scene(shots)
            by_name = {shot.name: shot for shot in shots}
            images = [town.photograph(by_name[name]) for name in scene.cameras.names]
            splats = town.train(scene, images, np.arange(len(shots)))
            row = ArmRow(
                seed=seed,
                arm=arm,
                psnr_db=town.score(splats),
                holes=town.holes(shots),
                clearance_m=min(town.photographer.clearance_m(shot.center_m) for shot in proposals.shots[arm]),
                cpu_s=time.process_time() - begun_s,
            )
            write_json(paths[arm], asdict(row))
            print(f"seed {seed} {arm}: {np.mean(row.psnr_db):.2f} dB, holes {100 * row.holes:.1f} %", file=sys.stderr)
    rows = [ArmRow(**{**read_json(paths[arm]), "psnr_db": tuple(read_json(paths[arm])["psnr_db"])}) for arm in ARMS]
    return rows, MapRow(**read_json(paths["map"]))


@app.command()
def again(
    out: Annotated[Path, typer.Option("--out", help="Folder of rows; a later call resumes.", show_default=False)],
    seeds: Annotated[int, typer.Option(min=1, max=100, help="Towns.")] = 5,
    width_px: Annotated[int, typer.Option(min=64, help="Width of the photographs.")] = 320,
    steps: Annotated[int, typer.Option(min=1, help="Steps of each training.")] = 1_500,
    flight: Annotated[str, typer.Option(help="survey, or street or orbit: what the first photographs are of.")] = "survey",
) -> None:
    """Print what 13 more photographs bring, by how they were chosen."""
    measured = [measure_seed(seed, out, width_px, steps, flight) for seed in range(seeds)]
    by_arm = {arm: [row for rows, _ in measured for row in rows if row.arm == arm] for arm in ARMS}
    print("arm        PSNR dB   holes %   clearance m   CPU s")
    for arm, rows in by_arm.items():
        psnr = np.mean([row.psnr_db for row in rows])
        holes, cpu_s = 100 * np.mean([row.holes for row in rows]), np.mean([row.cpu_s for row in rows])
        print(f"{arm:<10} {psnr:7.2f} {holes:9.2f} {min(row.clearance_m for row in rows):13.1f} {cpu_s:7.0f}")
    for compared in ARMS[1:]:
        gain = paired_bootstrap(*([np.array([row.psnr_db]) for row in by_arm[arm]] for arm in ("proposed", compared)))
        print(f"proposed − {compared}: {gain.mean:+.2f} dB ({gain.low:+.2f} to {gain.high:+.2f}), at least {gain.at_least:+.2f}")
    for _, row in measured:
        ranks = ", ".join(
            f"{name} {_text(rank)} ({_text(good)} as good as called)"
            for name, rank, good in (
                ("like those flown", row.rank_on_path, row.good_on_path),
                ("off the path", row.rank_off_path, row.good_off_path),
            )
        )
        print(
            f"seed {row.seed}: {row.facets} facets; rank in views {ranks}, held out {_text(row.rank_held_out)}; "
            f"map {row.map_s:.1f}, proposal {row.proposal_s:.1f} CPU s"
        )


def _text(figure: float | None) -> str:
    return "none" if figure is None else f"{figure:.2f}"


if __name__ == "__main__":
    try:
        app()
    except BadInput as error:
        print(error, file=sys.stderr)
        sys.exit(error.exit_code)
