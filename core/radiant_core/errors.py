"""The few errors of the project: bad input, a stage that failed, a file that cannot be written, a
stored file that changed."""

from __future__ import annotations


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


class StoreDamaged(BadInput):
    """A stored file is missing or its bytes are not those that were written."""
