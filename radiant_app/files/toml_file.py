"""Reading a user's TOML file: one sentence with file, key, what came and what is expected."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

from radiant_core.errors import BadInput

MAX_FILE_BYTES = 1 << 20
"""A fleet of thousands fits; a file of another kind given by mistake does not."""
MAX_KEY_PARTS = 16
"""Longer keys are refused before they are parsed: no file of ours has one."""
_DEEP_KEY = re.compile(rf"""(?<![\w-])(?:(?:[\w-]++|"[^"\n]*"|'[^'\n]*')[ \t]*+\.[ \t]*+){{{MAX_KEY_PARTS}}}""")


def load_toml(path: Path, kind: str) -> dict[str, Any]:
    """The tables of a TOML file; BadInput says what a `kind` ("system file") would have to be."""
    try:
        with path.open("rb") as file:
            data = file.read(MAX_FILE_BYTES + 1)
    except OSError as error:
        raise BadInput(f"{path}: cannot be read ({error.strerror}): give a {kind} in TOML.") from error
    if len(data) > MAX_FILE_BYTES:
        raise BadInput(f"{path}: larger than {MAX_FILE_BYTES} bytes, which no {kind} is: check the path.")
    try:
        text = data.decode()
        if _DEEP_KEY.search(text):
            raise BadInput(f"{path}: a key of more than {MAX_KEY_PARTS} parts, which no {kind} has: correct it there.")
        tables = tomllib.loads(text)
    except UnicodeDecodeError as error:
        raise BadInput(f"{path}: byte {error.start} is not UTF-8 text: give a {kind} in TOML.") from error
    except BadInput:
        raise
    except (ValueError, RecursionError) as error:  # ValueError: also integers of many digits
        raise BadInput(f"{path}: not a TOML file ({error}): correct it there.") from error
    if (key := _with_nul(tables)) is not None:
        raise BadInput(f"{path}: {key} holds the character U+0000, which neither a text nor a path of a {kind} has: correct it there.")
    return tables


def _with_nul(value: Any, key: str = "") -> str | None:
    """The key of a text with NUL, at which the system cuts names off; None where there is none."""
    if isinstance(value, str):
        return key if "\0" in value else None
    if isinstance(value, list):
        return next((deeper for item in value if (deeper := _with_nul(item, key))), None)
    if not isinstance(value, dict):
        return None
    named = ((f"{key}.{name}" if key else name, item) for name, item in value.items())
    return next((deeper for path, item in named if (deeper := path.replace("\0", "\\0") if "\0" in path else _with_nul(item, path))), None)
