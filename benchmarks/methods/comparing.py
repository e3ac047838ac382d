"""What devices spend on comparing versions of a scene. Once per joined scene."""

from __future__ import annotations

import time

import numpy as np
from scipy.spatial import KDTree

from benchmarks.methods.cells import Cell
from benchmarks.methods.emulated_latency import NodeWork
from radiant_core.aggregate.tree import scored_at
from radiant_core.hierarchy.in_process import InProcessRun
from radiant_core.hierarchy.recipe import Recipe
from radiant_core.light.held_out import held_out_psnr_db

COMPARISON_BYTES = 4_000
"""About what a device sends: scores.json of a run with some photographs."""


def comparisons(cell: Cell, recipe: Recipe, run: InProcessRun) -> list[NodeWork]:
    """What devices spend on comparing the versions of the scene, each in the held-out photographs
    that were taken nearest to its own. None is chosen by it here: those photographs report the
    figures that methods are compared by."""
    held_out = cell.scene.held_out_views
    if len(run.versions) < 2:
        return []
    device_of = {int(row): device for plan in recipe.edge_plans for device in plan.device_ids for row in plan.cameras_of(device)}
    nearest = np.asarray(KDTree(cell.scene.training.cameras.centers).query(held_out.cameras.centers)[1])
    owners, works = np.array([device_of[int(row)] for row in nearest]), []
    for device in sorted({*owners.tolist()}):
        of_device, begun_s = held_out.select(np.flatnonzero(owners == device)), time.process_time()
        for splats in run.versions.values():
            held_out_psnr_db(splats, of_device, recipe.backend)
        works.append(NodeWork(stage=scored_at(f"devices/{device}"), cpu_s=time.process_time() - begun_s, sent_bytes=COMPARISON_BYTES))
    return works
