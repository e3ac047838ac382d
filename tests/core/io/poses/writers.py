"""Alignments as their programs write them, from the table of conventions, by other means than the readers.

`wrong` exchanges one convention: "k" the sign of the radial coefficients, "p" p1 and p2, "c2w" the direction of the pose,
"yup" the axes of the camera, "half" the origin of the pixels, "center" centre and translation.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from tests.core.io.poses.bent_hamlet import Truth

F = np.diag([1.0, -1.0, -1.0])
LLA = (47.37, 8.54, 430.0)
UTM = np.array([465_300.0, 5_246_350.0, 430.0])
Writer = Callable[..., Path]


def wronged(truth: Truth, wrong: str | None) -> Truth:
    k1, k2, p1, p2, k3 = truth.dist
    R, t = truth.R, truth.t
    if wrong == "k":
        return replace(truth, dist=(-k1, -k2, p1, p2, -k3))
    if wrong == "p":
        return replace(truth, dist=(k1, k2, p2, p1, k3))
    if wrong == "c2w":
        return replace(truth, R=R.transpose(0, 2, 1), t=truth.C)
    if wrong == "yup":
        return replace(truth, R=F @ R, t=t @ F)
    if wrong == "center":
        return replace(truth, t=truth.C)
    if wrong == "half":
        return replace(truth, cx=truth.cx + 0.5, cy=truth.cy + 0.5)
    return truth


def _c2w(truth: Truth, number: int) -> np.ndarray:
    """World from camera (4,4) with OpenGL's axes."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = truth.R[number].T @ F, truth.C[number]
    return pose


def transforms(folder: Path, truth: Truth, wrong: str | None = None, *, applied: bool = True, ply: bool = False) -> Path:
    """nerfstudio's, with the applied transform of its files from COLMAP."""
    t = wronged(truth, wrong)
    A = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]]) if applied else np.eye(4)
    k1, k2, p1, p2, k3 = t.dist
    record: dict[str, Any] = {"camera_model": "OPENCV", "w": t.width, "h": t.height, "fl_x": t.fx, "fl_y": t.fy, "cx": t.cx, "cy": t.cy}
    record |= {"k1": k1, "k2": k2, "k3": k3, "p1": p1, "p2": p2}
    if applied:
        record["applied_transform"] = A[:3].tolist()
    record["frames"] = [
        {"file_path": f"./images/{name}", "transform_matrix": (A @ _c2w(t, number)).tolist()} for number, name in enumerate(t.names)
    ]
    if ply:
        record["ply_file_path"] = "sparse_pc.ply"
        points = t.points @ A[:3, :3].T
        rows = "".join(f"{x:.9f} {y:.9f} {z:.9f} {r} {g} {b}\n" for (x, y, z), (r, g, b) in zip(points, t.colors, strict=True))
        head = f"ply\nformat ascii 1.0\nelement vertex {len(points)}\nproperty float x\nproperty float y\nproperty float z\n"
        head += "property uint8 red\nproperty uint8 green\nproperty uint8 blue\nend_header\n"
        (folder / "sparse_pc.ply").write_text(head + rows)
    (folder / "transforms.json").write_text(json.dumps(record))
    return folder / "transforms.json"


def opensfm(folder: Path, truth: Truth, wrong: str | None = None, *, tracks: bool = False, lla: bool = True) -> Path:
    t = wronged(truth, wrong)
    side = max(t.width, t.height)
    k1, k2, p1, p2, k3 = t.dist
    camera = {
        "projection_type": "brown", "width": t.width, "height": t.height, "focal_x": t.fx / side, "focal_y": t.fy / side,
        "c_x": (t.cx - t.width / 2) / side, "c_y": (t.cy - t.height / 2) / side, "k1": k1, "k2": k2, "k3": k3, "p1": p1, "p2": p2,
    }  # fmt: skip
    shots = {}
    for number, name in enumerate(t.names):
        angle, axis = _axis_angle(t.R[number])
        shots[name] = {"rotation": (angle * axis).tolist(), "translation": t.t[number].tolist(), "camera": "v2 lens"}
    points = {
        str(row): {"coordinates": xyz.tolist(), "color": [float(value) for value in rgb]}
        for row, (xyz, rgb) in enumerate(zip(t.points, t.colors, strict=True))
    }
    part: dict[str, Any] = {"cameras": {"v2 lens": camera}, "shots": shots, "points": points}
    if lla:
        part["reference_lla"] = dict(zip(("latitude", "longitude", "altitude"), LLA, strict=True))
    small = {**part, "shots": dict(list(shots.items())[:1]), "points": {}}
    (folder / "reconstruction.json").write_text(json.dumps([small, part]))
    if tracks:
        lines = ["OPENSFM_TRACKS_VERSION_v2"]
        for (px, rows), name in zip(truth.seen, t.names, strict=True):
            for n, ((u, v), row) in enumerate(zip(px, rows, strict=True)):
                lines.append(f"{name}\t{row}\t{n}\t{(u - t.width / 2) / side:.9f}\t{(v - t.height / 2) / side:.9f}\t0.001\t1\t2\t3\t-1\t-1")
        (folder / "tracks.csv").write_text("\n".join(lines) + "\n")
    return folder / "reconstruction.json"


def _axis_angle(R: np.ndarray) -> tuple[float, np.ndarray]:
    """By the eigenvector of 1, not by the readers' library."""
    values, vectors = np.linalg.eig(R)
    axis = np.real(vectors[:, np.argmin(np.abs(values - 1))])
    angle = np.arccos(np.clip((np.trace(R) - 1) / 2, -1, 1))
    skew = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    for sign in (1.0, -1.0):
        if np.abs(np.eye(3) + np.sin(sign * angle) * skew + (1 - np.cos(angle)) * skew @ skew - R).max() < 1e-6:
            return sign * angle, axis
    raise AssertionError


def metashape(folder: Path, truth: Truth, wrong: str | None = None, *, ecef: np.ndarray | None = None) -> Path:
    """`ecef`: the (4,4) from the hamlet's metres to the earth's axes."""
    t = wronged(truth, wrong)
    k1, k2, p1, p2, k3 = t.dist
    W = np.eye(4) if ecef is None else ecef
    turn, scale, shift = _chunk()
    world_from_chunk = W @ np.block([[scale * turn, shift[:, None]], [np.zeros((1, 3)), np.ones((1, 1))]])
    cameras = []
    for number, name in enumerate(t.names):
        pose = np.eye(4)
        pose[:3, :3] = turn.T @ t.R[number].T
        pose[:3, 3] = turn.T @ (t.C[number] - shift) / scale
        cameras.append(
            f'<camera id="{number}" sensor_id="0" component_id="0" label="{Path(name).stem}"><transform>'
            + " ".join(repr(float(value)) for value in pose.ravel())
            + "</transform><orientation>1</orientation></camera>"
        )
    cameras.append('<camera id="99" sensor_id="0" label="unaligned"><orientation>1</orientation></camera>')
    lens = (
        f"<resolution width='{t.width}' height='{t.height}'/><f>{t.fy!r}</f><cx>{t.cx - t.width / 2!r}</cx><cy>{t.cy - t.height / 2!r}</cy>"
        f"<b1>{t.fx - t.fy!r}</b1><b2>{t.skew!r}</b2><k1>{k1!r}</k1><k2>{k2!r}</k2><k3>{k3!r}</k3><k4>{t.k4!r}</k4>"
        f"<p1>{p2!r}</p1><p2>{p1!r}</p2>"
    )
    linear = world_from_chunk[:3, :3] / np.cbrt(np.linalg.det(world_from_chunk[:3, :3]))
    numbers = [" ".join(repr(float(value)) for value in part.ravel()) for part in (linear, world_from_chunk[:3, 3])]
    system = "LOCAL_CS[&quot;Local&quot;]" if ecef is None else "GEOGCS[&quot;WGS 84&quot;]"
    (folder / "cameras.xml").write_text(
        f'<?xml version="1.0" encoding="UTF-8"?>\n<document version="2.0.0"><chunk label="Chunk 1"><sensors>'
        '<sensor id="0" label="L" type="frame">'
        f"<resolution width='{t.width}' height='{t.height}'/><calibration type='frame' class='initial'><f>100</f></calibration>"
        f"<calibration type='frame' class='adjusted'>{lens}</calibration></sensor></sensors>"
        f'<components><component id="0"><transform><rotation>{numbers[0]}</rotation><translation>{numbers[1]}</translation>'
        f"<scale>{float(np.cbrt(np.linalg.det(world_from_chunk[:3, :3])))!r}</scale></transform></component></components>"
        f"<cameras>{''.join(cameras)}</cameras><reference>{system}</reference></chunk></document>"
    )
    return folder / "cameras.xml"


def _chunk() -> tuple[np.ndarray, float, np.ndarray]:
    return Rotation.from_euler("zyx", [30, -12, 5], degrees=True).as_matrix(), 7.25, np.array([3.0, -4.0, 11.0])


def realityscan(folder: Path, truth: Truth, wrong: str | None = None) -> Path:
    """Angles by the elements of Rz(−h) Rx(p) Ry(r)."""
    t = wronged(truth, wrong)
    k1, k2, p1, p2, k3 = t.dist
    side = max(t.width, t.height)
    rows = [["#name", "x", "y", "alt", "heading", "pitch", "roll", "f", "px", "py", "k1", "k2", "k3", "k4", "t1", "t2"]]
    for number, name in enumerate(t.names):
        G = _c2w(t, number)[:3, :3]
        pitch, heading, roll = np.arcsin(G[2, 1]), np.arctan2(G[0, 1], G[1, 1]), np.arctan2(-G[2, 0], G[2, 2])
        rows.append(
            [name, *(repr(float(value)) for value in (*t.C[number], *np.degrees([heading, pitch, roll]), t.fx * 36 / side)),
             *(repr(float(value)) for value in ((t.cx - t.width / 2) / side, (t.cy - t.height / 2) / side, k1, k2, k3, t.k4, p1, p2))]
        )  # fmt: skip
    with (folder / "alignment.csv").open("w", newline="") as file:
        csv.writer(file).writerows(rows)
    return folder / "alignment.csv"


def pix4d(folder: Path, truth: Truth, wrong: str | None = None, *, prj: str | None = None, external: bool = True) -> Path:
    t = wronged(truth, wrong)
    k1, k2, p1, p2, k3 = t.dist
    offset = np.floor(UTM / 1000) * 1000
    move = UTM if prj is not None else np.zeros(3)
    head = ["fileName imageWidth imageHeight", "camera matrix K [3x3]", "radial distortion [3x1]", "tangential distortion [2x1]"]
    head += ["camera position t [3x1]", "camera rotation R [3x3]", "camera model m = K [R|-Rt] X", ""]
    lines, outer = list(head), ["imageName X Y Z Omega Phi Kappa"]
    for number, name in enumerate(t.names):
        lines.append(f"{name} {t.width} {t.height}")
        rows = (*t.K, (k1, k2, k3), (p1, p2), t.C[number] + move - offset, *t.R[number])
        lines += [" ".join(f"{value:.14f}" for value in row) for row in rows]
        G = _c2w(t, number)[:3, :3]
        omega, phi, kappa = np.arctan2(-G[1, 2], G[2, 2]), np.arcsin(G[0, 2]), np.arctan2(-G[0, 1], G[0, 0])
        outer.append(" ".join([name, *(f"{v:.9f}" for v in (*(t.C[number] + move), *np.degrees([omega, phi, kappa])))]))
    (folder / "p_calibrated_camera_parameters.txt").write_text("\n".join(lines) + "\n")
    (folder / "p_offset.xyz").write_text(" ".join(f"{value:.3f}" for value in offset))
    if external:
        (folder / "p_calibrated_external_camera_parameters.txt").write_text("\n".join(outer) + "\n")
    if prj is not None:
        (folder / "p_wkt.prj").write_text(prj)
    return folder / "p_calibrated_camera_parameters.txt"


def openmvg(folder: Path, truth: Truth, wrong: str | None = None, *, structure: bool = True) -> Path:
    t = wronged(truth, wrong)
    k1, k2, p1, p2, k3 = t.dist
    views: list[dict[str, Any]] = []
    extrinsics: list[dict[str, Any]] = []
    for number, name in enumerate(t.names):
        data = {
            "local_path": "/",
            "filename": name,
            "width": t.width,
            "height": t.height,
            "id_view": number,
            "id_intrinsic": 0,
            "id_pose": number,
        }
        views.append({"key": number, "value": {"polymorphic_id": 1 << 30, "ptr_wrapper": {"id": (1 << 31) + number + 1, "data": data}}})
        extrinsics.append({"key": number, "value": {"rotation": t.R[number].tolist(), "center": t.C[number].tolist()}})
    unplaced = {**views[0]["value"]["ptr_wrapper"]["data"], "id_view": 99, "id_pose": 99}
    views.append({"key": 99, "value": {"polymorphic_id": 1 << 30, "ptr_wrapper": {"id": 5, "data": unplaced}}})
    lens = {"width": t.width, "height": t.height, "focal_length": t.fx, "principal_point": [t.cx, t.cy], "disto_t2": [k1, k2, k3, p1, p2]}
    kind = {"polymorphic_id": (1 << 31) + 1, "polymorphic_name": "pinhole_brown_t2", "ptr_wrapper": {"id": (1 << 31) + 99, "data": lens}}
    seen: dict[int, list[Any]] = {row: [] for row in range(len(t.points))}
    for number, (px, rows) in enumerate(truth.seen):
        for place, row in zip(px, rows, strict=True):
            seen[int(row)].append({"key": number, "value": {"id_feat": 0, "x": place.tolist()}})
    landmarks = [{"key": row, "value": {"X": t.points[row].tolist(), "observations": each}} for row, each in seen.items()]
    record = {"sfm_data_version": "0.3", "root_path": "/elsewhere", "views": views, "intrinsics": [{"key": 0, "value": kind}]}
    record |= {"extrinsics": extrinsics, "structure": landmarks if structure else [], "control_points": []}
    (folder / "sfm_data.json").write_text(json.dumps(record))
    return folder / "sfm_data.json"


def bundler(folder: Path, truth: Truth, wrong: str | None = None) -> Path:
    """Its lens has no p1, p2, no principal point and one focal length: of a `Truth` with those."""
    t = wronged(truth, wrong)
    lines = ["# Bundle file v0.3", f"{len(t.names)} {len(t.points)}"]
    for number in range(len(t.names)):
        lines.append(f"{t.fx!r} {t.dist[0]!r} {t.dist[1]!r}")
        lines += [" ".join(repr(float(value)) for value in row) for row in (*(F @ t.R[number]), F @ t.t[number])]
    tracks: dict[int, list[str]] = {row: [] for row in range(len(t.points))}
    for number, (px, rows) in enumerate(truth.seen):
        for (u, v), row in zip(px, rows, strict=True):
            tracks[int(row)].append(f"{number} 0 {float(u - t.width / 2)!r} {float(t.height / 2 - v)!r}")
    for row, (xyz, rgb) in enumerate(zip(t.points, t.colors, strict=True)):
        lines += [" ".join(repr(float(value)) for value in xyz), " ".join(str(value) for value in rgb)]
        lines.append(" ".join([str(len(tracks[row])), *tracks[row]]))
    (folder / "bundle.out").write_text("\n".join(lines) + "\n")
    (folder / "list.txt").write_text("".join(f"{name} 0 {t.fx}\n" for name in t.names))
    return folder / "bundle.out"


def opf(folder: Path, truth: Truth, wrong: str | None = None, *, crs: str = "EPSG:25832") -> Path:
    """By hand from the specification; `test_opf_of_pyopf` has the one of its authors' library."""
    t = wronged(truth, wrong)
    k1, k2, p1, p2, k3 = t.dist
    shift = -np.floor(UTM)
    cameras = []
    for number in range(len(t.names)):
        G = _c2w(t, number)[:3, :3]
        angles = np.degrees([np.arctan2(-G[1, 2], G[2, 2]), np.arcsin(G[0, 2]), np.arctan2(-G[0, 1], G[0, 0])])
        cameras.append(
            {"id": 1000 + number, "sensor_id": 7, "orientation_deg": angles.tolist(), "position": (t.C[number] + UTM + shift).tolist()}
        )
    internals = {
        "type": "perspective", "principal_point_px": [t.cx, t.cy], "focal_length_px": t.fx,
        "radial_distortion": [k1, k2, k3], "tangential_distortion": [p1, p2],
    }  # fmt: skip
    parts = {
        "calibrated-cameras": {"sensors": [{"id": 7, "internals": internals}], "cameras": cameras},
        "camera-list": {"cameras": [{"id": 1000 + number, "uri": f"images/{name}"} for number, name in enumerate(t.names)]},
        "input-cameras": {"sensors": [{"id": 7, "name": "L", "image_size_px": [t.width, t.height]}], "captures": []},
        "scene-reference-frame": {
            "crs": {"definition": crs},
            "base_to_canonical": {"shift": shift.tolist(), "scale": [1, 1, 1], "swap_xy": False},
        },
    }
    items = []
    for name, content in parts.items():
        (folder / f"{name}.json").write_text(json.dumps({"format": f"application/opf-{name}+json", "version": "1.0", **content}))
        items.append(
            {"id": name, "type": name, "sources": [], "resources": [{"uri": f"{name}.json", "format": f"application/opf-{name}+json"}]}
        )
    (folder / "project.opf").write_text(json.dumps({"format": "application/opf-project+json", "version": "1.0", "items": items}))
    return folder / "project.opf"


def polycam(folder: Path, truth: Truth, wrong: str | None = None) -> Path:
    """No distortion; y up: (z, x, y) of the file is (x, y, z)."""
    t = wronged(truth, wrong)
    down = np.array([[0.0, 1, 0, 0], [0, 0, 1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
    place = folder / "keyframes" / "corrected_cameras"
    place.mkdir(parents=True)
    for number, name in enumerate(t.names):
        pose = down @ _c2w(t, number)
        record = {f"t_{row}{column}": float(pose[row, column]) for row in range(3) for column in range(4)}
        record |= {"width": t.width, "height": t.height, "fx": t.fx, "fy": t.fy, "cx": t.cx, "cy": t.cy}
        (place / f"{Path(name).stem}.json").write_text(json.dumps(record))
    return sorted(place.glob("*.json"))[0]
