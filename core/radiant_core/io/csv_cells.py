"""Cells of CSV for spreadsheets: no name in them is a formula. Once per cell of text.

A spreadsheet computes whatever begins with = + - or @, also behind a semicolon where that separates
cells; a formula can start programs and send files away. One ' before it makes it text:

    =1+1  →  '=1+1        a;-2  →  a;'-2        '=1  →  ''=1

`text_of_cell` takes it away again, so that our own reader finds the name that was written.
"""

from __future__ import annotations

import re

_FORMULA = re.compile(r"(^|;)('*)(?=[=+\-@＝＋－＠])")
_MARKED = re.compile(r"(^|;)('*)'(?=[=+\-@＝＋－＠])")


def cell_of_text(text: str) -> str:
    """The text as a cell that no spreadsheet computes."""
    return _FORMULA.sub(r"\1\2'", text)


def text_of_cell(cell: str) -> str:
    """What `cell_of_text` was given."""
    return _MARKED.sub(r"\1\2", cell)
