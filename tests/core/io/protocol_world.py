"""A made-up network between senders and one receiver, and a checker of what happened: the upload
protocol under everything that goes wrong.

Time is a number in a queue of events, so that nothing waits. Messages are dropped, doubled, delayed
(and so overtake each other) and held back by partitions; senders stop for good or make their files
anew; old messages of this and another run are played again; the receiver dies and comes back with
what it had stored.
"""

from __future__ import annotations

import hashlib
import heapq
import itertools
import random
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace

from radiant_core.io.transport.acceptance import Acceptance, Offer

RECEIVER = "edges/north"
RETRY_S, HORIZON_S = 5.0, 3000.0
MAX_EVENTS = 50_000


@dataclass
class World:
    """One schedule, drawn from a seed."""

    seed: int
    history: list[tuple[float, str, Offer, str]] = field(default_factory=list)
    """Time, status, offer and reason of every answer of the receiver."""

    def __post_init__(self) -> None:
        self.rng = random.Random(self.seed)
        self.queue: list[tuple[float, int, Callable[[], None]]] = []
        self.order = itertools.count()
        self.now_s = 0.0
        self.run = f"{self.seed:032x}"
        self.senders = [f"devices/d{index}" for index in range(self.rng.randint(2, 6))]
        # One lives and is reached in the end; the others may stop for good, be cut off, or be slow.
        self.dies_s = {sender: self.rng.choice([HORIZON_S * 2, self.rng.uniform(0, 200)]) for sender in self.senders}
        self.dies_s[self.senders[0]] = HORIZON_S * 2
        self.cut_until_s = {sender: self.rng.choice([0.0, self.rng.uniform(0, 400)]) for sender in self.senders}
        self.slow = {sender: self.rng.choice([1.0, 1.0, 8.0]) for sender in self.senders}
        self.drop, self.double = self.rng.uniform(0, 0.6), self.rng.uniform(0, 0.4)
        self.told: set[tuple[str, str]] = set()
        """Sender and region that were acknowledged or refused: the sender stops."""
        self.seen: list[Offer] = []
        """Messages that somebody recorded and plays again."""
        self.state = Acceptance(run=self.run, receiver=RECEIVER, senders={f"r{i}": sender for i, sender in enumerate(self.senders)})
        self.stored = self.state
        self.accepted_once: dict[str, Offer] = {}
        for region, sender in self.state.senders.items():
            self._begin(region, sender)
        for _ in range(self.rng.randint(0, 10)):
            self.at(self.rng.uniform(0, 500), self._replay)
        for _ in range(self.rng.randint(0, 4)):
            self.at(self.rng.uniform(0, 500), self._restart)

    def at(self, delay_s: float, act: Callable[[], None]) -> None:
        heapq.heappush(self.queue, (self.now_s + delay_s, next(self.order), act))

    def play(self) -> None:
        """Until nothing is left to happen; fails where that does not come."""
        for _ in range(MAX_EVENTS):
            if not self.queue or self.queue[0][0] > HORIZON_S:
                return
            self.now_s, _, act = heapq.heappop(self.queue)
            act()
        raise AssertionError(f"seed {self.seed} does not end")

    def _begin(self, region: str, sender: str) -> None:
        trained_s = self.rng.uniform(1, 50) * self.slow[sender]
        self.at(trained_s, lambda: self._send(region, sender, 1))
        if self.rng.random() < 0.2:
            # Restarted, it makes its files anew: another attempt with other bytes.
            self.at(trained_s + self.rng.uniform(0, 40), lambda: self._send(region, sender, 2))

    def _send(self, region: str, sender: str, attempt: int) -> None:
        if self.now_s >= self.dies_s[sender] or (sender, region) in self.told:
            return
        digest = hashlib.sha256(f"{region} {attempt}".encode()).hexdigest()
        offer = Offer(run=self.run, receiver=RECEIVER, region=region, sender=sender, attempt=attempt, digest=digest)
        if self.now_s >= self.cut_until_s[sender]:
            self._transmit(lambda: self._arrive(offer))
        self.at(RETRY_S * self.rng.uniform(0.5, 2), lambda: self._send(region, sender, attempt))

    def _transmit(self, deliver: Callable[[], None]) -> None:
        for _ in range(2 if self.rng.random() < self.double else 1):
            if self.rng.random() >= self.drop:
                self.at(self.rng.choice([0.1, self.rng.uniform(0, 20), self.rng.uniform(0, 300)]), deliver)

    def _arrive(self, offer: Offer) -> None:
        self.seen.append(offer)
        state, verdict = self.state.offer(offer)
        if state is not self.state:
            self.state = state
            if self.rng.random() < 0.1:
                # It dies before the new state is on disk: nothing was acknowledged, the sender
                # tries again.
                self.state = self.stored
                return
            self.stored = self.state
        self.history.append((self.now_s, verdict.status, offer, verdict.reason))
        if verdict.status == "accepted":
            assert offer.region not in self.accepted_once, f"seed {self.seed}: {offer.region} was accepted twice"
            self.accepted_once[offer.region] = offer
        if self.now_s >= self.cut_until_s.get(offer.sender, 0):
            self._transmit(lambda: self._hear(offer, verdict.status))

    def _hear(self, offer: Offer, status: str) -> None:
        # A refusal of an older attempt does not stop a newer one.
        if status != "rejected" or offer.region in self.state.accepted:
            self.told.add((offer.sender, offer.region))

    def _replay(self) -> None:
        if self.seen:
            old = self.rng.choice(self.seen)
            other = self.rng.choice(
                [
                    old,
                    replace(old, run="f" * 32),
                    replace(old, receiver="edges/south"),
                    replace(old, sender=self.rng.choice(self.senders)),
                    replace(old, region="r99"),
                ]
            )
            self._arrive(other)

    def _restart(self) -> None:
        self.state = self.stored


def check_history(world: World) -> None:
    """One accepted upload of every region, by its sender; only a stopped sender leaves none."""
    accepted = world.state.accepted
    missing = world.state.senders.keys() - accepted.keys()
    assert all(world.dies_s[world.state.senders[region]] < HORIZON_S for region in missing), f"seed {world.seed}: {missing} never came"
    told = {offer.region: offer for _, status, offer, _ in world.history if status == "accepted"}
    assert dict(accepted) == told == world.accepted_once, f"seed {world.seed}: what was acknowledged is not what is stored"
    for region, offer in accepted.items():
        assert (offer.run, offer.receiver, offer.sender) == (world.run, RECEIVER, world.state.senders[region]), f"seed {world.seed}"
    for _, status, offer, reason in world.history:
        assert status != "duplicate" or accepted[offer.region].digest == offer.digest
        assert status != "rejected" or reason


REASONS = ("belongs to run", "is addressed to", "is none of", "is to deliver", "was accepted first")


def played(seeds: Iterable[int]) -> Counter[str]:
    """Play and check a schedule per seed; how often each answer was given, and each reason."""
    counts: Counter[str] = Counter()
    for seed in seeds:
        world = World(seed)
        world.play()
        check_history(world)
        counts.update(status for _, status, _, _ in world.history)
        counts.update(word for _, _, _, reason in world.history for word in REASONS if word in reason)
    return counts
