"""The few errors of the project: bad input, a stage that failed, a file that cannot be written, a
stored file that changed."""

from __future__ import annotations

import errno
import os

_FULL = (errno.ENOSPC, errno.EDQUOT)
"""What the system says of a disk, or a share of it, without room."""


class RadiantError(Exception):
    """Base of all errors that a user may cause and read; `exit_code` is what the command line
    returns: 2 where another input helps."""

    exit_code = 1


class BadInput(RadiantError, ValueError):
    """An input cannot be used; the message says what came, what was expected and what to do."""

    exit_code = 2


class StageFailed(RadiantError):
    """A stage of a run did not finish; the message names the stage and its reason."""


class CannotWrite(BadInput):
    """A file of ours cannot be written, most often since the disk is full: no fault of the input,
    and what stands there is kept."""


def way_to_write(
    error: BaseException,
    full: str = "free space or choose another output folder",
    other: str = "choose another folder that may be written",
) -> str:
    """What helps after `error` of writing: `full` where the disk has no room, else `other`.

    Libraries wrap what the system said, so its words count beside its number.
    """
    if getattr(error, "errno", None) in _FULL or any(os.strerror(code) in str(error) for code in _FULL):
        return full
    return other


class StoreDamaged(BadInput):
    """A stored file is missing or its bytes are not those that were written."""
