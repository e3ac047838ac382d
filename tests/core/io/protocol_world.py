"""A made-up network between senders and one receiver, and a checker of what happened: the upload protocol under everything that goes wrong.

Time is a number in a queue of events, so that nothing waits. Messages are dropped, doubled, delayed (and so overtake each other) and
held back by partitions; senders stop for good or make their files anew; old messages of this and another run are played again; the
receiver dies and comes back with what it had stored. Deadlines pass, and what has not arrived is planned again on those that live.
"""

from __future__ import annotations

import hashlib
import heapq
import itertools
import json
import random
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace

from radiant_core.io.transport.acceptance import Acceptance, Offer, acceptance_of

RECEIVER = "edges/north"
RETRY_S, DEADLINE_S, HORIZON_S = 5.0, 60.0, 3000.0
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
        self.cameras = {f"c{index}" for index in range(self.rng.randint(len(self.senders), 30))}
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
        self.stored = ""
        self.state = Acceptance(run=self.run, receiver=RECEIVER)
        self.accepted_once: dict[str, Offer] = {}
        self._deal()

    def _deal(self) -> None:
        dealt = sorted(self.cameras)
        self.rng.shuffle(dealt)
        for index, sender in enumerate(self.senders):
            region = f"r{index}"
            self.state = self.state.planned(region, sender, dealt[index :: len(self.senders)])
            self._begin(region, sender)
        self._store()
        self.at(DEADLINE_S, self._deadline)
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
                # It dies before the new state is on disk: nothing was acknowledged, the sender tries again.
                self.state = acceptance_of(json.loads(self.stored))
                return
            self._store()
        self.history.append((self.now_s, verdict.status, offer, verdict.reason))
        if verdict.status == "accepted":
            assert offer.region not in self.accepted_once, f"seed {self.seed}: {offer.region} was accepted twice"
            self.accepted_once[offer.region] = offer
        if self.now_s >= self.cut_until_s.get(offer.sender, 0):
            self._transmit(lambda: self._hear(offer, verdict.status))

    def _hear(self, offer: Offer, status: str) -> None:
        region = self.state.regions.get(offer.region)
        # A refusal of an older attempt does not stop a newer one.
        if status != "rejected" or offer.region in self.state.closed or (region is not None and offer.region in self.state.accepted):
            self.told.add((offer.sender, offer.region))

    def _deadline(self) -> None:
        alive = [sender for sender in self.senders if self.now_s < self.dies_s[sender]]
        for region in self.state.waiting:
            owner = self.state.regions[region].sender
            if owner in alive and self.rng.random() < 0.5 and self.now_s < 8 * DEADLINE_S:
                continue
            takers = self.rng.sample(alive, self.rng.randint(1, len(alive)))
            held = sorted(self.state.regions[region].cameras)
            parts = {f"{region}.{i}": (taker, held[i :: len(takers)]) for i, taker in enumerate(takers) if held[i :: len(takers)]}
            self.state = self.state.replanned(region, parts)
            for name, (sender, _) in parts.items():
                self._begin(name, sender)
        self._store()
        if self.state.waiting:
            self.at(4 * DEADLINE_S, self._deadline)

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

    def _store(self) -> None:
        self.stored = json.dumps(self.state.record())

    def _restart(self) -> None:
        self.state = acceptance_of(json.loads(self.stored))


def check_history(world: World) -> None:
    """Every camera in exactly one accepted upload, none of those lost, each by the one who was to send it, and nobody still waits."""
    accepted = world.state.accepted
    assert not world.state.waiting, f"seed {world.seed}: {world.state.waiting} never came"
    delivered = [camera for region in accepted for camera in world.state.regions[region].cameras]
    assert sorted(delivered) == sorted(world.cameras), f"seed {world.seed}"
    told = {offer.region: offer for _, status, offer, _ in world.history if status == "accepted"}
    assert dict(accepted) == told == world.accepted_once, f"seed {world.seed}: what was acknowledged is not what is stored"
    for region, offer in accepted.items():
        planned = world.state.regions[region]
        assert (offer.run, offer.receiver, offer.sender) == (world.run, RECEIVER, planned.sender), f"seed {world.seed}"
    for _, status, offer, reason in world.history:
        assert status != "duplicate" or accepted[offer.region].digest == offer.digest
        assert status != "rejected" or reason


REASONS = ("belongs to run", "is addressed to", "is none of", "is to deliver", "planned again", "was accepted first")


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
