"""`python -m tests.run_code [-W error] PROGRAM ARGUMENTS`: what `python` does with the same words,
where it is a fork (`forked.py`). PROGRAM is `-c CODE`, `-m MODULE` or the path of a script."""

from __future__ import annotations

import runpy
import sys
import warnings
from pathlib import Path


def main(words: list[str]) -> None:
    """Run the program as the main one."""
    if words[:2] == ["-W", "error"]:
        warnings.simplefilter("error")
        del words[:2]
    if words[0] == "-m":
        sys.argv = words[1:]
        runpy.run_module(words[1], run_name="__main__", alter_sys=True)
    elif words[0] == "-c":
        sys.argv = ["-c", *words[2:]]
        exec(compile(words[1], "<string>", "exec"), {"__name__": "__main__"})
    else:
        sys.argv = words
        sys.path.insert(0, str(Path(words[0]).resolve().parent))
        runpy.run_path(words[0], run_name="__main__")


if __name__ == "__main__":
    main(sys.argv[1:])
