"""Depth views fused into a mesh by a process of its own, sized before. Once per surface.

    python -m radiant_core.geometry.fusion FOLDER
    bytes = `BASE_BYTES` + blocks · `BYTES_PER_BLOCK`,  blocks of 16³ voxels ∝ 1 / voxel²
Where Open3D ends that process by a signal, that is a sentence here, and its tables are ample. The
views lie in a temporary folder, some 2 MB each at 640 px, beside the result where the caller says
so, since /tmp may be memory: they are counted first, then fused, 0.2 s each.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np

from radiant_core.errors import BadInput, way_to_write
from radiant_core.geometry.open3d_ops import MAX_BLOCKS, DepthView, Mesh, count_blocks, fused_mesh

BYTES_PER_BLOCK = 140_000
"""16³ voxels of 20 bytes, and 60,000 of the mesh that goes through them: measured."""
BASE_BYTES = 1_500_000_000
"""Open3D itself, and the part of the mesh that is being made."""
MIN_BLOCKS = 2_000
"""What is tried however little memory is free: 0.3 GB beside Open3D."""
MEMORY_SHARE = 0.75
"""Of the free memory: more may be needed elsewhere by the time."""
_SETTINGS, _MESH = "settings.json", "mesh.safetensors"


@dataclass(frozen=True, kw_only=True)
class FusionSettings:
    """voxel, in the model's unit, coarser where its blocks of 16³ are more than max_blocks unless
    it `is_fixed`; depth up to max_depth."""

    voxel: float
    is_fixed: bool
    max_depth: float
    max_blocks: int = MAX_BLOCKS


@dataclass(frozen=True, kw_only=True, eq=False)
class Fusion:
    """The mesh, the voxel it has, and how many blocks of 16³ voxels that took."""

    mesh: Mesh
    voxel: float
    num_blocks: int


def blocks_within(memory_bytes: int) -> int:
    """How many blocks fit where so many bytes are free."""
    return int(np.clip((MEMORY_SHARE * memory_bytes - BASE_BYTES) / BYTES_PER_BLOCK, MIN_BLOCKS, MAX_BLOCKS))


def fuse_apart(
    views: Iterable[DepthView], settings: FusionSettings, report: Callable[[int, int], None], scratch: Path | None = None
) -> Fusion:
    """The mesh of depth views, made by another process; `report` gets views fused and their total.

    The views go into a hidden folder in `scratch`, by default the system's for temporary files, and
    are removed in the end. Raises BadInput, which names a resolution that would do, where a fixed
    one takes too many blocks, and where that process ends early.
    """
    with tempfile.TemporaryDirectory(prefix=".radiant-surface-", dir=scratch) as name:
        folder = Path(name)
        try:
            for index, view in enumerate(views):
                _save_view(folder / f"{index:06d}.safetensors", view)
        except OSError as error:
            way = way_to_write(error, "free space there")
            raise BadInput(f"the depth views cannot be written to {folder}: {error.strerror or error}: {way}.") from error
        (folder / _SETTINGS).write_text(json.dumps(asdict(settings)))
        answer = _answer(folder, settings, report)
        if "fitting_voxel" in answer:
            raise BadInput(
                f"cells of {settings.voxel:.3g} take {answer['num_blocks']:,} blocks of 16³ voxels, "
                f"{(BASE_BYTES + answer['num_blocks'] * BYTES_PER_BLOCK) / 1e9:.1f} GB, and {settings.max_blocks:,} are possible here: "
                f"choose --resolution {round_up(answer['fitting_voxel']):g} or coarser, or free memory."
            )
        return Fusion(mesh=_load_mesh(folder / _MESH), voxel=answer["voxel"], num_blocks=answer["num_blocks"])


def round_up(value: float) -> float:
    """A positive number with two digits, not below `value`: 0.2131 → 0.22."""
    step = 10.0 ** (np.floor(np.log10(value)) - 1)
    return float(f"{np.ceil(value / step - 1e-9) * step:.6g}")


def worker_command(folder: Path) -> list[str]:
    """How the other process is started."""
    return [sys.executable, "-m", "radiant_core.geometry.fusion", str(folder)]


def _answer(folder: Path, settings: FusionSettings, report: Callable[[int, int], None]) -> dict[str, Any]:
    """The last line that the other process says."""
    last: dict[str, Any] = {}
    log = folder / "log.txt"
    with log.open("wb") as errors:
        process = subprocess.Popen(worker_command(folder), stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors, text=True)
        with process:
            assert process.stdout is not None
            try:
                for line in process.stdout:
                    last = json.loads(line)
                    if "done" in last:
                        report(last["done"], last["total"])
                code = process.wait()
            finally:
                process.kill()
    if code == 0 and "num_blocks" in last:
        return last
    words = log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
    reason = f"was ended by signal {-code}" if code < 0 else f"ended with code {code} ({words[-1] if words else 'it said nothing'})"
    raise BadInput(
        f"the surface in cells of {settings.voxel:.3g} was not made: the process that fuses it {reason}; "
        f"choose a coarser one, --resolution {round_up(2 * settings.voxel):g}, or free memory."
    )


def _save_view(path: Path, view: DepthView) -> None:
    from safetensors.numpy import save

    arrays = {"image": view.image, "depth": view.depth, "K": view.K, "cam_from_world": view.cam_from_world}
    path.write_bytes(save({name: np.ascontiguousarray(array) for name, array in arrays.items()}))


def _load_mesh(path: Path) -> Mesh:
    from safetensors.numpy import load_file

    return Mesh(**load_file(path))


def main(folder: Path, say: IO[str]) -> int:
    """Count and fuse the views in `folder`; the last line of `say` holds the figures, the mesh lies
    beside the views."""
    from safetensors.numpy import load_file, save_file

    settings = FusionSettings(**json.loads((folder / _SETTINGS).read_text()))
    paths = sorted(folder.glob("[0-9]*.safetensors"))

    def tell(line: dict[str, Any]) -> None:
        say.write(json.dumps(line) + "\n")
        say.flush()

    def views(report: bool = False) -> Iterator[DepthView]:
        for num_done, path in enumerate(paths, 1):
            yield DepthView(**load_file(path))
            if report:
                tell({"done": num_done, "total": len(paths)})

    def count(voxel: float) -> int:
        return count_blocks(views(), voxel, settings.max_depth)

    voxel, num_blocks = fitting_voxel(count, settings)
    if settings.is_fixed and voxel > settings.voxel:
        answer = {"num_blocks": num_blocks, "fitting_voxel": voxel}
    else:
        mesh = fused_mesh(views(report=True), voxel, settings.max_depth, num_blocks)
        save_file({"vertices": mesh.vertices, "triangles": mesh.triangles, "colors": mesh.colors}, folder / _MESH)
        answer = {"num_blocks": num_blocks, "voxel": voxel}
    tell(answer)
    return 0


def fitting_voxel(count: Callable[[float], int], settings: FusionSettings) -> tuple[float, int]:
    """The finest voxel from the settings' on whose blocks are possible; and its blocks, or those of
    a fixed one."""
    voxel = settings.voxel
    first = num_blocks = count(voxel)
    while num_blocks > settings.max_blocks:
        # A surface's blocks fall with the square; 5 % more, so that the next count is not one over.
        voxel *= 1.05 * max(1.05, float(np.sqrt(num_blocks / settings.max_blocks)))
        num_blocks = count(voxel)
    return voxel, first if settings.is_fixed else num_blocks


def _end_with_the_parent() -> None:
    while os.read(0, 1):
        pass
    os._exit(1)


if __name__ == "__main__":
    threading.Thread(target=_end_with_the_parent, daemon=True).start()
    # Libraries print to file descriptor 1 too.
    words = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    sys.exit(main(Path(sys.argv[1]), words))
