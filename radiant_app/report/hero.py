"""The pictures of the model at the head of a report: all around it, to be turned by hand."""

from __future__ import annotations

NUM_SIDES = 24
SIZE_WH = (1080, 700)
