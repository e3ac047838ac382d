"""SuperSplat Viewer, which draws Gaussians in a browser, as it came from npm. Once per page.

@playcanvas/supersplat-viewer 1.36.2 (MIT): public/index.js without its last line, which names a
file of 7 MB for debuggers, public/index.css, and the licences of it and of the engine in it. It is
kept here, 0.75 MB packed, and not fetched when a page is made: an export must work without a
network, and give the same page next year.
"""

from __future__ import annotations

import hashlib
import io
import zipfile
from pathlib import Path

from radiant_core.errors import StoreDamaged

VERSION = "1.36.2"
SCRIPT, STYLE, LICENSES = "supersplat-viewer.js", "viewer.css", "LICENSES.txt"
SHA256 = "dbb11ba5725ac1d5cf70221087d3900830bed262878557d960f247e1d527a004"
_ARCHIVE = Path(__file__).with_name("supersplat_viewer.zip")


def viewer_files() -> dict[str, bytes]:
    """Script, style and licences by name; StoreDamaged where the package was changed."""
    try:
        data = _ARCHIVE.read_bytes()
    except OSError as error:
        raise StoreDamaged(f"cannot read {_ARCHIVE}: {error.strerror or error}: install radiant again.") from error
    if hashlib.sha256(data).hexdigest() != SHA256:
        raise StoreDamaged(f"{_ARCHIVE} is not the viewer that came with radiant: install it again.")
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        return {name: archive.read(name) for name in (SCRIPT, STYLE, LICENSES)}
