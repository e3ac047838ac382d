"""What the planner's words mean: the one table behind the hovers of window and page.

docs/glossary.md explains each at more length; `tests/viewer/test_words.py` holds the two together.
"""

from __future__ import annotations

MEANINGS = {
    "edge": "A machine that owns one region, gathers the models of its devices and passes them on as one.",
    "device": "A machine that holds photographs and trains one model from them.",
    "region": "The ground that one edge is responsible for, a convex polygon.",
    "strip": "The part of a region that one device trains.",
    "makespan": "The time at which the slowest edge is done: computing, not flying.",
    "bound": "The least makespan that any assignment of the cameras can have under the given cost curves.",
    "certificate": "A proof, over all cameras, that no other assignment with these counts is better.",
    "slack": "How many times the bound the makespan may be, in exchange for shorter ways; 1 means none.",
    "load": "The time of a machine as a share of the makespan.",
    "holds": "The most photographs that a device has memory for.",
    "locked": "A region that keeps the cameras it has and gets no others.",
    "pinned": "A camera that belongs to an edge by hand, whatever the planner thinks.",
    "change hands": "Cameras that belong to another edge than before.",
    "held out": "Excluded from plan and training, and used only to score the result.",
    "seam": "A step of colour or detail along the border between two regions.",
    "level": "A step of brightness, of 255 from black to white; below some 10 an eye hardly sees it.",
    "PSNR": "How near a render is to its photograph, in dB: 20 is rough, 25 good, 30 hard to tell.",
}
"""Term → one sentence, in the order of the glossary."""
LAYER_TERMS = {
    "Regions": ("region", "edge"),
    "Device strips": ("strip", "device"),
    "Edges": ("edge",),
    "Edge loads": ("load", "makespan"),
    "Changed hands": ("change hands",),
    "Constraints": ("locked", "pinned"),
    "Seams": ("seam", "level"),
}
"""Layer → the terms that its hover explains."""


def counted(count: int, noun: str) -> str:
    """Return "1 region", "2 regions", "1,000 regions"."""
    return f"{count:,} {noun}{'s' * (count != 1)}"


def tip(*terms: str) -> str:
    """Return a hover for terms: a line for each with what it means."""
    return "\n".join(f"{term}: {MEANINGS[term]}" for term in terms)
