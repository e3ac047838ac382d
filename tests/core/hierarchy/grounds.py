"""Messages of a made-up ground that three devices or edges share."""

from __future__ import annotations

from dataclasses import replace

from radiant_core.aggregate.config import AggregateConfig, Join
from radiant_core.hierarchy.messages import CloudTask, DeviceModel, EdgeModel, EdgeTask
from radiant_core.splats import Splats
from radiant_core.train.config import train_preset
from tests.core.scenes import cameras_above, ground_splats

TRAIN = replace(train_preset("draft"), num_steps=20, long_side_px=48, max_num_splats=400)
AGGREGATE = AggregateConfig(cloud=Join(epochs=1)).joining_after(None)
NAMES = ("a", "b", "c")
MIDDLES = (-2.0, 0.0, 2.0)
CAMERAS = tuple(cameras_above([(x, -1.0), (x, 1.0)]) for x in MIDDLES)


def part(index: int) -> Splats:
    """The ground of sender `index` of three: its third and what it sees beside, a little off."""
    ground = ground_splats(seed=index)
    return ground.select(abs(ground.means[:, 0] - MIDDLES[index]) < 2.5)


def device_models() -> dict[str, DeviceModel]:
    """Three devices' models as they arrive."""
    return {
        name: DeviceModel(splats=part(index), cameras=CAMERAS[index], received={"model.safetensors": f"{index}" * 64})
        for index, name in enumerate(NAMES)
    }


def edge_task(*devices: str, **changes: object) -> EdgeTask:
    """Join these devices' models; everything else as given."""
    strips = {name: ((x - 1.0, -9.0), (x + 1.0, -9.0), (x + 1.0, 9.0), (x - 1.0, 9.0)) for name, x in zip(NAMES, MIDDLES, strict=True)}
    task = EdgeTask(
        devices=devices,
        num_dealt=(2,) * len(devices),
        strips=tuple(strips[name] for name in devices),
        train=TRAIN,
        join=AGGREGATE.edge,
        backend="native",
    )
    return replace(task, **changes)


def edge_models() -> dict[str, EdgeModel]:
    """Three edges' models as they arrive."""
    return {name: EdgeModel(splats=part(index), cameras=CAMERAS[index]) for index, name in enumerate(NAMES)}


def cloud_task(*edges: str, **changes: object) -> CloudTask:
    """Join these edges' models; everything else as given."""
    task = CloudTask(
        edges=edges,
        num_dealt=(2,) * len(edges),
        sites=tuple((MIDDLES[NAMES.index(name)], 0.0) for name in edges),
        weights=(0.0,) * len(edges),
        train=TRAIN,
        join=AGGREGATE.cloud,
        backend="native",
    )
    return replace(task, **changes)
