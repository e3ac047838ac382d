"""Images in a file are the same as in memory, to the bit, whatever is selected, cropped or joined."""

from __future__ import annotations

import errno
import gc
import os
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from radiant_core.errors import BadInput, CannotWrite
from radiant_core.train.checkpoint import training_key
from radiant_core.train.config import train_preset
from radiant_core.train.stored_images import (
    Images,
    StoredImages,
    Window,
    concatenate_images,
    crop_images,
    select_images,
    shapes_of,
    store_views,
)
from radiant_core.train.trainer import FitOptions, fit_splats
from radiant_core.train.views import TrainingViews, concatenate_views
from tests.core.scenes import cameras_above, ground_splats

SIZES_HW = ((36, 48), (1, 1), (7, 301), (50, 20))
CAMERAS = cameras_above([(x, y) for x in (-2.0, 0.0, 2.0) for y in (-1.0, 1.0)])


def views(seed: int = 0, sizes_hw: tuple[tuple[int, int], ...] = SIZES_HW) -> list[tuple[np.ndarray, np.ndarray]]:
    rng = np.random.default_rng(seed)
    return [(rng.integers(0, 256, (*size, 3), np.uint8), rng.integers(0, 256, size, np.uint8)) for size in sizes_hw]


def both(folder: Path, seed: int = 0) -> Iterator[tuple[Images, Images]]:
    """Images and weights, each in memory and in a file."""
    return zip(store_views(iter(views(seed)), None), store_views(iter(views(seed)), folder), strict=True)


def assert_same(ours: Images, theirs: Images) -> None:
    assert len(ours) == len(theirs) and list(shapes_of(ours)) == list(shapes_of(theirs))
    for index, (one, other) in enumerate(zip(ours, theirs, strict=True)):
        np.testing.assert_array_equal(one, other)
        np.testing.assert_array_equal(theirs[index], one)
        assert other.dtype == np.uint8 and other.flags.writeable


def test_what_lies_in_a_file_is_what_was_in_memory_and_no_file_is_seen(tmp_path: Path) -> None:
    for kept, stored in both(tmp_path):
        assert isinstance(kept, tuple) and isinstance(stored, StoredImages)
        assert_same(kept, stored)
    assert list(tmp_path.iterdir()) == []


def test_selected_cropped_and_joined_images_are_the_same_too(tmp_path: Path) -> None:
    windows: list[Window] = [(3, 30, 5, 48), (0, 1, 0, 1), (6, 7, 300, 301), (0, 50, 0, 20)]
    others = list(both(tmp_path, seed=1))
    for (kept, stored), (more, more_stored) in zip(both(tmp_path), others, strict=True):
        for rows in ([2, 0], [], [1, 1], np.array([3])):
            assert_same(select_images(kept, rows), select_images(stored, rows))
        cropped = crop_images(stored, windows)
        assert_same(crop_images(kept, windows), cropped)
        assert all(image.flags.c_contiguous for image in cropped)
        assert_same(concatenate_images([kept, more]), concatenate_images([stored, more_stored]))
        assert_same(concatenate_images([kept, more]), concatenate_images([kept, more_stored]))
        assert isinstance(concatenate_images([stored, more_stored]), StoredImages)
        assert_same(select_images(crop_images(kept, windows), [2, 0]), select_images(cropped, [2, 0]))
        assert_same(concatenate_images([]), ())


@pytest.mark.parametrize("name", ["gone", "file"])
def test_a_folder_that_is_none_cannot_hold_them(name: str, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(CannotWrite, match=rf"{name} cannot hold the pictures that models are joined by \(.+\)"):
        store_views(views(), tmp_path / name)


def test_a_disk_without_room_cannot_hold_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make = tempfile.TemporaryFile

    class Full:
        """A file that takes 1,000 bytes."""

        def __init__(self, **where: Path) -> None:
            self._file = make(dir=where["dir"])
            self.tell, self.close = self._file.tell, self._file.close

        def write(self, data: memoryview) -> int:
            if self._file.tell() + data.nbytes > 1000:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            return self._file.write(data)

    monkeypatch.setattr(tempfile, "TemporaryFile", Full)
    with pytest.raises(CannotWrite, match=r"\(No space left on device\): free space there"):
        store_views(views(), tmp_path)


def test_the_file_goes_with_its_last_user(tmp_path: Path) -> None:
    def num_open() -> int:
        return sum(str(path.resolve()).startswith(str(tmp_path)) for path in Path("/proc/self/fd").iterdir())

    images, weights = store_views(views(), tmp_path)
    image = images[0]
    some = select_images(images, [0])
    del images, weights
    gc.collect()
    assert num_open() == 1
    np.testing.assert_array_equal(some[0], image)
    del some
    gc.collect()
    assert num_open() == 0


def training_views(folder: Path | None) -> TrainingViews:
    """Made-up views of the ground; those of the first camera are a second part, as of a second teacher."""
    sizes = tuple((int(height), int(width)) for width, height in CAMERAS.sizes_wh)
    images, weights = store_views(iter(views(5, sizes)), folder)
    whole = TrainingViews(cameras=CAMERAS, images=images, weights=weights)
    return concatenate_views([whole.select([0]), whole.select(np.arange(1, len(CAMERAS)))])


def test_a_training_on_views_in_a_file_gives_the_same_bits(tmp_path: Path) -> None:
    config = replace(train_preset("draft"), num_steps=12, max_num_splats=500)
    # The second keeps no statistics, so that each step reads.
    for options in (FitOptions(), FitOptions(statistics_bytes=0)):
        stored, kept = (fit_splats(ground_splats(), training_views(folder), config, options) for folder in (tmp_path, None))
        assert (stored.first_loss, stored.last_loss) == (kept.first_loss, kept.last_loss)
        for name, array in kept.splats.arrays().items():
            np.testing.assert_array_equal(array, stored.splats.arrays()[name], err_msg=name)


def test_a_checkpoint_of_one_goes_on_with_the_other(tmp_path: Path) -> None:
    config = train_preset("draft")
    keys = {training_key(ground_splats(), training_views(folder), config, FitOptions()) for folder in (tmp_path, None)}
    assert len(keys) == 1
    brighter = training_views(tmp_path)
    other = replace(brighter, images=tuple(255 - image for image in brighter.images))
    assert training_key(ground_splats(), other, config, FitOptions()) not in keys


def test_views_in_a_file_are_scaled_and_refused_as_those_in_memory(tmp_path: Path) -> None:
    stored, kept = training_views(tmp_path).scaled(0.5), training_views(None).scaled(0.5)
    assert_same(kept.images, stored.images)
    images, weights = store_views(views(), tmp_path)
    with pytest.raises(BadInput, match=r"is \(36, 48, 3\) uint8, expected \(36, 49, 3\) uint8"):
        TrainingViews(cameras=replace(CAMERAS.select([0]), sizes_wh=np.array([[49, 36]])), images=select_images(images, [0]))
    with pytest.raises(BadInput, match="weights and images differ in size"):
        TrainingViews(cameras=CAMERAS.select([0]), images=select_images(images, [0]), weights=select_images(weights, [1]))
