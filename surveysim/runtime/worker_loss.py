"""Errors of engines, and the limit of lost workers."""

import logging

LOSSES_ALLOWED = 3  # workers lost with the same item; then the item is the probable cause

log = logging.getLogger("surveysim")


class EngineError(RuntimeError):
    """An engine that can't continue: its workers or its scheduler are lost or unusable."""


def too_many_losses(exit_code: int | None = None) -> EngineError:
    """Make the error for an item that has lost `LOSSES_ALLOWED` workers, the last with this exit code if known."""
    ended_itself = exit_code is not None and exit_code > 0
    how = f"the last with exit code {exit_code}" if ended_itself else "perhaps killed because memory ran out"
    return EngineError(f"{LOSSES_ALLOWED} worker processes were lost with the same work, {how}")
