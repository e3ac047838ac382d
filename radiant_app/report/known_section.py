"""The section of a run's report on what is known of its surface, put in when the map is made."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jinja2

from radiant_core.io.run_store import write_atomic

BEGIN, END = "<!-- known -->", "<!-- end of known -->"
"""Between them the section stands in report.html; nothing before a map is made."""


def add_known_section(report: Path, picture: Path, figures: Mapping[str, Any]) -> bool:
    """Put picture and figures of a map into the page of its run, in place of those of an earlier
    map; False where there is no such page, or one without a place for it."""
    text = report.read_text(encoding="utf-8") if report.is_file() else ""
    before, begin, behind = text.partition(BEGIN)
    _, end, after = behind.partition(END)
    if not (begin and end):
        return False
    page = jinja2.Environment(loader=jinja2.PackageLoader("radiant_app"), autoescape=True, undefined=jinja2.StrictUndefined)
    section = page.get_template("known.html.j2").render(figures=figures, picture=b64encode(picture.read_bytes()).decode())
    write_atomic(report, f"{before}{BEGIN}{section}{END}{after}".encode())
    return True
