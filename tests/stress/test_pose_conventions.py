"""Every convention of every format, wrong: each is refused with its figure."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.core.io.poses.test_readers import FORMATS, bent, refuse, wrongs_of

__all__ = ["bent"]


@pytest.mark.stress
@pytest.mark.parametrize(("name", "wrong"), [(name, wrong) for name in FORMATS for wrong in wrongs_of(name)])
def test_a_wrong_convention_is_refused(name: str, wrong: str, tmp_path: Path, bent) -> None:
    print(name, wrong, refuse(name, wrong, tmp_path, bent))
