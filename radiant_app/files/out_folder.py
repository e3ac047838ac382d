"""The folders that a file named by --out is to lie in: looked at before the work, made for it when
it is written; and files that appear there together or not at all."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from radiant_core.errors import BadInput


def require_folder_for(out: Path) -> None:
    """Raise BadInput where the folder of `out` neither is one nor can be made."""
    nearest = next((folder for folder in out.parents if os.path.lexists(folder)), None)
    if nearest is None or nearest.is_dir():
        return
    leads_nowhere = nearest.is_symlink() and not nearest.exists()
    obstacle = f"a link to {nearest.readlink()}, which does not exist" if leads_nowhere else "a file"
    raise BadInput(f"{nearest} is {obstacle}, expected a folder to write {out.name} into: choose another place.")


@contextmanager
def folder_made_for(out: Path) -> Iterator[None]:
    """Make the folders that `out` is to lie in, and remove those again where the block fails;
    BadInput where they cannot be made."""
    require_folder_for(out)
    missing = [folder for folder in out.parents if not folder.exists()]
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInput(f"cannot make the folder {out.parent} ({error.strerror}): choose another place for {out.name}.") from error
    try:
        yield
    except BaseException:
        for folder in missing:
            # What others have put there meanwhile stays.
            with suppress(OSError):
                folder.rmdir()
        raise


@contextmanager
def write_folder_atomically(target: Path) -> Iterator[Path]:
    """A hidden folder inside `target` whose content moves there when the block ends well, and
    vanishes when it does not."""
    folder = Path(tempfile.mkdtemp(prefix=".plan.", dir=target))
    try:
        yield folder
        # The plan itself last: where it stands, everything else does.
        ordered = sorted(folder.iterdir(), key=lambda path: path.suffix == ".json")
        try:
            for path in ordered:
                path.rename(target / path.name)
        except BaseException:
            for path in (target / path.name for path in ordered):
                shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)
            raise
    finally:
        shutil.rmtree(folder)
