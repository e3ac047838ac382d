"""Photographs, views and pairs dealt to threads, results in their order. Once per block of
tasks."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

import cv2

Task = TypeVar("Task")
Result = TypeVar("Result")


def usual_threads() -> int:
    """As many threads as torch has, which processes that share a machine are each told."""
    import torch

    return torch.get_num_threads()


@contextmanager
def single_opencv_thread() -> Generator[None]:
    """OpenCV with one thread: photographs are dealt to threads here."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


def in_order(work: Callable[[Task], Result], tasks: Sequence[Task], num_threads: int) -> Iterator[Result]:
    """The results of `tasks`; after an interruption no other task begins."""
    pool = ThreadPoolExecutor(max_workers=num_threads)
    try:
        yield from pool.map(work, tasks)
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
