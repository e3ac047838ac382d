"""The pages and docstrings become a site without a warning, and every page is in it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import radiant

ROOT = Path(__file__).parents[2]


def test_the_site_is_built_without_a_warning(tmp_path: Path) -> None:
    command = [sys.executable, "tools/site.py", str(tmp_path / "site")]
    result = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=False, timeout=600)
    assert result.returncode == 0, result.stderr[-3000:]
    html = tmp_path / "site/html"
    pages = {path.relative_to(ROOT / "docs").with_suffix("").as_posix() for path in (ROOT / "docs").rglob("*.md")}
    assert all((html / f"{page}.html").is_file() for page in pages)
    api = (html / "api.html").read_text()
    assert [name for name in radiant.__all__ if f'id="radiant.{name}"' not in api and name != "__version__"] == []
    # A link to a file of the source, which the site does not have, would lead out of it.
    assert '="../core/' not in (html / "life_of_a_photograph.html").read_text()
