"""Which uploads an edge or the cloud accepts: pure functions of a state. Once per upload.

Of the uploads of a region, the first valid one (right run, receiver and sender) wins. A second one
is a duplicate where its files are the same, which acknowledges it again, else it is rejected. A
sender repeats its upload until it is acknowledged or rejected; repeating does no harm. Pure, so
that tests can try every order of events. Signatures and hashes are checked before: `delivery.py`.

Tasks, which go down, follow the other law (`LastTask`): a task replaces the one before, so the
newest attempt wins and no older one comes back.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Literal

Status = Literal["accepted", "duplicate", "rejected"]


@dataclass(frozen=True, kw_only=True)
class Offer:
    """What a verified upload states about itself."""

    run: str
    receiver: str
    region: str
    """What its sender is to deliver."""
    sender: str
    attempt: int
    digest: str
    """Hash of what was sent: equal for equal files."""


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """What became of an offer; its sender is done after "duplicate" as after "accepted"."""

    status: Status
    reason: str = ""


@dataclass(frozen=True, kw_only=True)
class Acceptance:
    """The uploads that one receiver expects and has accepted; every change is a new state."""

    run: str
    receiver: str
    senders: Mapping[str, str]
    """Region → the sender that is to deliver it."""
    accepted: Mapping[str, Offer] = field(default_factory=lambda: MappingProxyType({}))
    """Region → its upload."""

    def offer(self, offer: Offer) -> tuple[Acceptance, Verdict]:
        """The state after an upload arrived, and the verdict for its sender."""
        reason = self._refusal(offer)
        if reason:
            return self, Verdict(status="rejected", reason=reason)
        accepted = self.accepted.get(offer.region)
        if accepted is None:
            return replace(self, accepted={**self.accepted, offer.region: offer}), Verdict(status="accepted")
        if accepted.digest == offer.digest:
            return self, Verdict(status="duplicate", reason=f"these files were accepted as attempt {accepted.attempt}.")
        return self, Verdict(status="rejected", reason=f"attempt {accepted.attempt} was accepted first, this is attempt {offer.attempt}.")

    def _refusal(self, offer: Offer) -> str:
        """Why an upload could not be accepted even if it were the first; empty where it could."""
        if stray := _stray(offer, self.run, self.receiver):
            return stray
        sender = self.senders.get(offer.region)
        if sender is None:
            return f"region {offer.region[:80]!r} is none of this run's."
        if offer.sender != sender:
            return f"{offer.sender[:80]!r} sends region {offer.region!r}, which {sender!r} is to deliver."
        return ""


@dataclass(frozen=True, kw_only=True)
class LastTask:
    """The newest task that a node accepted from its parent; attempt 0: none yet."""

    run: str
    receiver: str
    sender: str
    attempt: int = 0
    digest: str = ""

    def offer(self, offer: Offer) -> tuple[LastTask, Verdict]:
        """The state after a task arrived, and the verdict; the same task again, on which a
        restarted node works, is a duplicate."""
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
    """Why something is of another run or addressed to another node; empty where it is neither."""
    if offer.run != run:
        return f"it belongs to run {offer.run[:40]!r}, this is {run!r}."
    if offer.receiver != receiver:
        return f"it is addressed to {offer.receiver[:80]!r}, this is {receiver!r}."
    return ""
