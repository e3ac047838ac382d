"""The page of `radiant join RUN --photographs`: held-out photographs and cells before and after."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader

from radiant_app.files.run_folder import Manifest
from radiant_core.io.run_store import write_atomic

KINDS = ("photographs", "renders", "differences")


def write_added_page(folder: Path, metrics: Mapping[str, Any], manifest: Manifest, picture: str) -> None:
    """Write report.html into the folder of an extended run, by its metrics, record and picture."""
    page = Environment(loader=PackageLoader("radiant_app"), autoescape=True).get_template("added.html.j2")
    text = page.render(
        metrics=metrics,
        extension=metrics["extension"],
        config=manifest.config,
        decisions=manifest.decisions,
        warnings=manifest.warnings,
        known=_encoded(folder / picture),
        pictures={
            row["name"]: [_encoded(folder / "pictures" / kind / f"{row['name']}.png") for kind in KINDS] for row in metrics["images"]
        },
    )
    write_atomic(folder / "report.html", text.encode())


def _encoded(path: Path) -> str:
    return b64encode(path.read_bytes()).decode()
