"""`python -m radiant_app.bench.leakage RUN`: how like the private photographs are what an edge and the cloud of a finished run can look at.

    edge    each device's model at its photographs' own cameras, which the edge holds
    cloud   the pictures that edges sent at virtual cameras, each against the photograph whose camera is nearest: as they are, and laid over
            it by the homography that fits best (the cloud has no photograph to fit to; whoever looks at the picture needs none)

PSNR and SSIM as means over photographs; RUN keeps its devices' photographs where they lay. A few renders and fits per photograph.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from radiant_app.workers.inbox import VIRTUAL_CAMERAS, VIRTUAL_VIEWS
from radiant_app.workers.nodes import load_images
from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.evaluate.image_error import psnr_db, ssim
from radiant_core.io.records import load_cameras, load_scene, load_splats
from radiant_core.io.run_store import read_json
from radiant_core.io.view_file import load_views

Image = NDArray[np.float32]
FIT_STEPS, FIT_CHANGE = 50, 1e-4


@dataclass(frozen=True, kw_only=True)
class Likeness:
    """Means over photographs."""

    num_images: int
    psnr_db: float
    ssim: float

    def __str__(self) -> str:
        return f"{self.psnr_db:.1f} dB, SSIM {self.ssim:.2f} ({self.num_images} photographs)"


@dataclass(frozen=True, kw_only=True)
class SentPictures:
    """What an edge sent the cloud to look at, and how far its virtual cameras stand from the photographs' (V,)."""

    as_sent: Likeness
    laid_over: Likeness
    moved_m: NDArray[np.float64]
    turned_deg: NDArray[np.float64]


def at_own_cameras(device: Path, long_side_px: int) -> Likeness:
    """What a device's model shows at the cameras of its photographs, against them."""
    from radiant_core.render.rendered_view import render_views

    cameras = load_scene(device / "scene.safetensors").cameras.scaled(long_side_px)
    rendered = render_views(load_splats(device / "model.safetensors"), cameras)
    return _likeness([(view.image, photograph) for view, photograph in zip(rendered, _photographs(device, cameras), strict=True)])


def sent_pictures(run: Path, edge: str, devices: list[str], long_side_px: int) -> SentPictures | None:
    """What `edge` sent of the photographs of its `devices`; None where it sent no pictures."""
    inbox = run / "cloud" / "inbox" / edge
    virtual = load_cameras(inbox / VIRTUAL_CAMERAS).scaled(long_side_px)
    if not (inbox / VIRTUAL_VIEWS).is_file():
        return None
    pictures = load_views(inbox / VIRTUAL_VIEWS, [(int(width), int(height)) for width, height in virtual.sizes_wh])
    if not pictures:
        return None
    pairs: list[tuple[Image, Image]] = []
    moved_m: list[float] = []
    turned_deg: list[float] = []
    for name in devices:
        own = load_scene(run / "devices" / name / "scene.safetensors").cameras.scaled(long_side_px)
        distances_m = np.linalg.norm(own.centers[:, None] - virtual.centers, axis=2)
        for row, photograph in enumerate(_photographs(run / "devices" / name, own)):
            near = int(distances_m[row].argmin())
            moved_m.append(float(distances_m[row, near]))
            turn = own.cam_from_world[row, :3, :3] @ virtual.cam_from_world[near, :3, :3].T
            turned_deg.append(float(np.degrees(2 * np.arcsin(min(1.0, np.linalg.norm(turn - np.eye(3)) / np.sqrt(8))))))
            height, width = photograph.shape[:2]
            shown = cv2.resize(pictures[near][0].astype(np.float32) / np.float32(255), (width, height))
            pairs.append((np.asarray(shown, np.float32), photograph))
    return SentPictures(
        as_sent=_likeness(pairs),
        laid_over=_likeness([(_laid_over(shown, photograph), photograph) for shown, photograph in pairs]),
        moved_m=np.array(moved_m),
        turned_deg=np.array(turned_deg),
    )


def _laid_over(shown: Image, photograph: Image) -> Image:
    """The picture moved onto the photograph by the homography with the best correlation; where it shows nothing, and where none is found,
    as it was."""
    grey = [cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) for image in (photograph, shown)]
    rule = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, FIT_STEPS, FIT_CHANGE)
    try:
        _, warp = cv2.findTransformECC(grey[0], grey[1], np.eye(3, dtype=np.float32), cv2.MOTION_HOMOGRAPHY, rule)
    except cv2.error:
        return shown
    height, width = photograph.shape[:2]
    moved = shown.copy()
    how = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpPerspective(shown, warp, (width, height), moved, how, cv2.BORDER_TRANSPARENT), np.float32)


def _photographs(device: Path, cameras: Cameras) -> list[Image]:
    """The photographs of a device at the cameras' sizes: in its own folder, or where they lie."""
    own = device / "own.json"
    folder = Path(read_json(own, ("images",))["images"]) if own.is_file() else device / "photos"
    return [image.astype(np.float32) / np.float32(255) for image in load_images(folder, cameras)]


def _likeness(pairs: list[tuple[Image, Image]]) -> Likeness:
    return Likeness(
        num_images=len(pairs),
        psnr_db=float(np.mean([psnr_db(shown, photograph) for shown, photograph in pairs])),
        ssim=float(np.mean([ssim(shown, photograph) for shown, photograph in pairs])),
    )


def main(run: Path) -> None:
    """Print a line per device and edge."""
    if not (run / "cloud" / "inbox").is_dir():
        raise BadInput(f"{run} is no finished run of several edges: there is no cloud/inbox.")
    side_px = int(read_json(run / "cloud" / "task.json", ("train",))["train"]["long_side_px"])
    for edge in sorted(path.name for path in (run / "cloud" / "inbox").iterdir()):
        devices = sorted(path.name for path in (run / "edges" / edge / "inbox").iterdir())
        for name in devices:
            print(f"device {name} at its own cameras, as its edge can render them: {at_own_cameras(run / 'devices' / name, side_px)}")
        sent = sent_pictures(run, edge, devices, side_px)
        if sent is None:
            print(f"edge {edge} sent the cloud no pictures")
            continue
        print(f"edge {edge} sent the cloud pictures: {sent.as_sent}; laid over the photographs: {sent.laid_over}")
        print(
            f"its virtual cameras are {np.median(sent.moved_m):.2f} m ({sent.moved_m.min():.2f} to {sent.moved_m.max():.2f}) and "
            f"{np.median(sent.turned_deg):.2f}° (from {sent.turned_deg.min():.2f}) from the nearest photograph's"
        )


if __name__ == "__main__":
    main(Path(sys.argv[1]))
