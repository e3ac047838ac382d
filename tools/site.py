"""The pages as a site that can be read offline: `python tools/site.py [OUT]`, by default build/site.

    docs/, README, ARCHITECTURE, … ─ links that fit a site ─→ OUT/source ─ Sphinx ─→ OUT/html
    `import radiant`               ─ its docstrings ──────────────┘

Sphinx, since it reads docstrings as they stand, is kept, and has a theme (furo) and a reader of
Markdown (MyST) that are kept too; MkDocs has had no release since 2024. A warning is an error: a
link that leads nowhere ends the build.
"""

from __future__ import annotations

import re
import shutil
import sys
from pathlib import Path

from sphinx.cmd.build import build_main

import radiant

ROOT = Path(__file__).parents[1]
ROOT_PAGES = ("README.md", "ARCHITECTURE.md", "CONTRIBUTING.md", "CHANGELOG.md", "SECURITY.md", "examples/README.md")
CONF = """
project = "Radiant"
author = "The authors of Radiant"
version = release = {version!r}
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
html_theme = "furo"
html_title = "Radiant {version}"
myst_heading_anchors = 5
autodoc_typehints = "signature"
autodoc_member_order = "bysource"
# Pages begin with what suits GitHub.
suppress_warnings = ["myst.header"]
"""
USERS = (
    "getting_started", "system_files", "from_the_field", "python", "planning", "inspector", "survey", "sharing", "coordinates", "network",
    "platforms",
)  # fmt: skip
"""Pages of `docs` that stand first, where they are there; the others follow by name."""
_LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^)\s]+)\)")


def assemble(source: Path) -> None:
    """Write the source of the site into a new folder."""
    shutil.copytree(ROOT / "docs", source)
    pages = {ROOT / "docs" / path.relative_to(source): path for path in sorted(source.rglob("*.md"))}
    for name in ROOT_PAGES:
        if (ROOT / name).is_file():
            pages[ROOT / name] = source / "project" / name.replace("/README", "").lower()
    (source / "project").mkdir(exist_ok=True)
    for original, page in pages.items():
        page.write_text(_LINK.sub(lambda link, original=original, page=page: _fitted(link, original, page, pages), original.read_text()))
    (source / "api.md").write_text(api_page())
    (source / "index.md").write_text(index_page(source))
    (source / "conf.py").write_text(CONF.format(version=radiant.__version__))


def _fitted(link: re.Match[str], original: Path, page: Path, pages: dict[Path, Path]) -> str:
    """A link as it is right on the site: to a page or picture there or, where it leads to a file of
    the source, its words alone."""
    mark, words, target = link.groups()
    path, _, anchor = target.partition("#")
    if "://" in target or not path:
        return link.group()
    site, there = pages[ROOT / "docs/README.md"].parent, (original.parent / path).resolve()
    if there in pages:
        place = pages[there]
    elif there / "README.md" in pages:
        place = pages[there / "README.md"]
    elif there.is_file() and there.is_relative_to(ROOT / "docs"):
        place = site / there.relative_to(ROOT / "docs")
    else:
        return words
    up = [".."] * len(page.parent.relative_to(site).parts)
    return f"{mark}[{words}]({Path(*up, place.relative_to(site)).as_posix()}{'#' + anchor if anchor else ''})"


def api_page() -> str:
    """What `import radiant` offers, by its docstrings."""
    lines = ["# `import radiant`", "", "```{eval-rst}", ".. automodule:: radiant", "   :no-members:", ""]
    for name in radiant.__all__:
        value = getattr(radiant, name)
        if isinstance(value, type):
            lines += [f".. autoclass:: radiant.{name}", *([] if issubclass(value, Exception) else ["   :members:"]), ""]
        elif callable(value):
            lines += [f".. autofunction:: radiant.{name}", ""]
    return "\n".join([*lines, "```", ""])


def index_page(source: Path) -> str:
    """The table of contents."""
    names = sorted(path.stem for path in source.glob("*.md") if path.stem not in ("index", "api"))
    first = [name for name in USERS if name in names]
    others = [name for name in names if name not in first and name != "README"]
    tree = ["project/readme", *first, "api", *others]
    parts = [("Using it", tree), ("Experiments", sorted(f"experiments/{path.stem}" for path in (source / "experiments").glob("*.md")))]
    parts.append(("The project", sorted(f"project/{path.stem}" for path in (source / "project").glob("*.md") if path.stem != "readme")))
    toctrees = "".join(f"\n```{{toctree}}\n:caption: {title}\n:maxdepth: 1\n\n" + "\n".join(names) + "\n```\n" for title, names in parts)
    return f"# Radiant\n{toctrees}\n```{{toctree}}\n:hidden:\n\nREADME\n```\n"


def main() -> int:
    """Build the site; the exit status of Sphinx."""
    out = Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "build/site"
    shutil.rmtree(out, ignore_errors=True)
    assemble(out / "source")
    status = build_main(["-q", "-W", "--keep-going", "-b", "html", str(out / "source"), str(out / "html")])
    if not status:
        print(f"written: {out / 'html/index.html'}")
    return status


if __name__ == "__main__":
    raise SystemExit(main())
