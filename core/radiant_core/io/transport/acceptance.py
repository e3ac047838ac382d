"""Which uploads an edge or the cloud takes: a state and pure functions of it, so that every order of events can be tried in tests.

    open region ──offer: right run, receiver, sender, attempt──→ accepted          the first valid one wins
         │                                                        a second one: duplicate (same files, acknowledged) or rejected
         └──replan──→ closed; its cameras are in new open regions, and whatever still comes of it is rejected

A region is what one sender is to deliver: a set of cameras. At every time each camera is in exactly one region that is open or accepted,
since only the receiver closes regions and accepts uploads; a camera of an accepted region is never planned again. A sender repeats its
upload until it is acknowledged or rejected; repeating does no harm. Signatures and hashes are checked before: `delivery.py`.

What goes down has the other law (`LastTask`): a task replaces the one before, so the newest attempt wins and no older one comes back.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, Literal

from radiant_core.errors import BadInput

Status = Literal["accepted", "duplicate", "rejected"]


@dataclass(frozen=True, kw_only=True)
class Offer:
    """What a verified upload says of itself."""

    run: str
    receiver: str
    region: str
    sender: str
    attempt: int
    digest: str
    """Hash of what was sent: equal for equal files."""


@dataclass(frozen=True, kw_only=True)
class Region:
    """Cameras that one sender is to deliver; attempts below `first_attempt` do not count any more."""

    sender: str
    cameras: frozenset[str]
    first_attempt: int = 1


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """What became of an offer; "duplicate" tells the sender that it is done, as "accepted" does."""

    status: Status
    reason: str = ""


@dataclass(frozen=True, kw_only=True)
class Acceptance:
    """What one receiver waits for, has accepted and has closed; every change is a new state."""

    run: str
    receiver: str
    regions: Mapping[str, Region] = field(default_factory=lambda: MappingProxyType({}))
    """All that were ever planned."""
    accepted: Mapping[str, Offer] = field(default_factory=lambda: MappingProxyType({}))
    closed: frozenset[str] = frozenset()

    def __post_init__(self) -> None:
        if not (set(self.accepted) | self.closed) <= set(self.regions) or self.closed & set(self.accepted):
            raise BadInput("an accepted or closed region was never planned, or is both: restore the stored state.")
        counted: set[str] = set()
        for name in self.regions.keys() - self.closed:
            if counted & self.regions[name].cameras:
                twice = min(counted & self.regions[name].cameras)
                raise BadInput(f"camera {twice!r} is in two regions that count: close the one it is taken from first.")
            counted |= self.regions[name].cameras

    @property
    def waiting(self) -> tuple[str, ...]:
        """Regions that are open, sorted."""
        return tuple(sorted(self.regions.keys() - self.accepted.keys() - self.closed))

    def offer(self, offer: Offer) -> tuple[Acceptance, Verdict]:
        """The state after an upload came, and what to tell its sender."""
        reason = self._refusal(offer)
        if reason:
            return self, Verdict(status="rejected", reason=reason)
        known = self.accepted.get(offer.region)
        if known is None:
            return replace(self, accepted={**self.accepted, offer.region: offer}), Verdict(status="accepted")
        if known.digest == offer.digest:
            return self, Verdict(status="duplicate", reason=f"these files were accepted as attempt {known.attempt}.")
        return self, Verdict(status="rejected", reason=f"attempt {known.attempt} was accepted first, this is attempt {offer.attempt}.")

    def _refusal(self, offer: Offer) -> str:
        """Why an upload could not be taken even if it were the first; empty where it could."""
        if stray := _stray(offer, self.run, self.receiver):
            return stray
        region = self.regions.get(offer.region)
        if region is None:
            return f"region {offer.region[:80]!r} is none of this run's."
        if offer.sender != region.sender:
            return f"{offer.sender[:80]!r} sends region {offer.region!r}, which {region.sender!r} is to deliver."
        if offer.region in self.closed:
            return f"region {offer.region!r} was planned again and is delivered by others."
        if offer.attempt < region.first_attempt:
            return f"attempt {offer.attempt} came late, attempts count from {region.first_attempt} on."
        return ""

    def planned(self, region: str, sender: str, cameras: Iterable[str], first_attempt: int = 1) -> Acceptance:
        """The state with one more open region; BadInput where its name was used before or a camera of it counts elsewhere."""
        if region in self.regions:
            raise BadInput(f"region {region!r} was planned before: give it a new name.")
        more = Region(sender=sender, cameras=frozenset(cameras), first_attempt=first_attempt)
        return replace(self, regions={**self.regions, region: more})

    def replanned(self, region: str, pieces: Mapping[str, tuple[str, Iterable[str]]]) -> Acceptance:
        """The state with an open region closed and its cameras in new ones: name → sender and cameras.

        Raises BadInput where the region is not open or the pieces do not hold exactly its cameras, each once.
        """
        if region not in self.waiting:
            raise BadInput(f"region {region!r} is not open: only what has not arrived can be planned again.")
        cameras = {name: frozenset(held) for name, (_, held) in pieces.items()}
        together = frozenset[str]().union(*cameras.values())
        if together != self.regions[region].cameras or sum(map(len, cameras.values())) != len(together):
            raise BadInput(f"the new regions of {region!r} do not hold each of its {len(self.regions[region].cameras)} cameras once.")
        state = replace(self, closed=self.closed | {region})
        for name, (sender, _) in pieces.items():
            state = state.planned(name, sender, cameras[name])
        return state

    def record(self) -> dict[str, Any]:
        """The state as plain values for JSON; `acceptance_of` reads it."""
        regions = {name: {**vars(region), "cameras": sorted(region.cameras)} for name, region in self.regions.items()}
        accepted = {name: dict(vars(offer)) for name, offer in self.accepted.items()}
        return {"run": self.run, "receiver": self.receiver, "regions": regions, "accepted": accepted, "closed": sorted(self.closed)}


@dataclass(frozen=True, kw_only=True)
class LastTask:
    """The newest task that a node took from the one above it; attempt 0: none yet."""

    run: str
    receiver: str
    sender: str
    attempt: int = 0
    digest: str = ""

    def offer(self, offer: Offer) -> tuple[LastTask, Verdict]:
        """The state after a task came, and what became of it; the same one again is a duplicate, which a restarted node works on."""
        reason = _stray(offer, self.run, self.receiver)
        if not reason and offer.sender != self.sender:
            reason = f"it comes from {offer.sender[:80]!r}, tasks for {self.receiver!r} come from {self.sender!r}."
        if not reason and offer.attempt < self.attempt:
            reason = f"attempt {offer.attempt} is old, attempt {self.attempt} was taken."
        if not reason and offer.attempt == self.attempt and offer.digest != self.digest:
            reason = f"other files were taken as attempt {self.attempt}."
        if reason:
            return self, Verdict(status="rejected", reason=reason)
        if offer.attempt == self.attempt:
            return self, Verdict(status="duplicate", reason=f"these files were taken as attempt {self.attempt}.")
        return replace(self, attempt=offer.attempt, digest=offer.digest), Verdict(status="accepted")


def _stray(offer: Offer, run: str, receiver: str) -> str:
    """Why something is of another run or meant for somebody else; empty where it is neither."""
    if offer.run != run:
        return f"it belongs to run {offer.run[:40]!r}, this is {run!r}."
    if offer.receiver != receiver:
        return f"it is addressed to {offer.receiver[:80]!r}, this is {receiver!r}."
    return ""


def acceptance_of(record: Mapping[str, Any]) -> Acceptance:
    """The state that `record` wrote; BadInput where it is none."""
    try:
        regions = {name: Region(**{**region, "cameras": frozenset(region["cameras"])}) for name, region in record["regions"].items()}
        accepted = {name: Offer(**offer) for name, offer in record["accepted"].items()}
        closed = frozenset(record["closed"])
        return Acceptance(run=record["run"], receiver=record["receiver"], regions=regions, accepted=accepted, closed=closed)
    except (KeyError, TypeError, AttributeError) as error:
        raise BadInput(f"a stored state of uploads is damaged ({type(error).__name__}: {error}): begin the run again.") from error
