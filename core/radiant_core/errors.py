"""The few errors of the project: bad input, a failed stage, a full disk, a changed file."""

from __future__ import annotations


class RadiantError(Exception):
    """Base of all errors that a user may cause; `exit_code` is 2 where another input helps."""

    exit_code = 1


class BadInput(RadiantError, ValueError):
    """An input cannot be used; the message says what came, what was expected and what to do."""

    exit_code = 2


class StageFailed(RadiantError):
    """A stage of a run did not finish; the message names the stage and its reason."""


class CannotWrite(BadInput):
    """A file of ours cannot be written, most often on a full disk; what stands there is kept."""


class StoreDamaged(BadInput):
    """A stored file is missing or its bytes are not those that were written."""
