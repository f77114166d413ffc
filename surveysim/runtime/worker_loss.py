"""What happens to an engine that loses workers."""

import logging

LOSSES_ALLOWED = 3  # of the workers that had an item: one that kills them all is the reason itself

log = logging.getLogger("surveysim")


class EngineError(RuntimeError):
    """An engine that can't go on: its workers or its scheduler are gone, or can't be used; the text says which."""


def too_many_losses(exit_code: int | None = None) -> EngineError:
    """The error of an item whose workers are gone again and again, the last with an exit code if it is known."""
    ended_itself = exit_code is not None and exit_code > 0
    how = f"the last with exit code {exit_code}" if ended_itself else "perhaps killed because memory ran out"
    return EngineError(f"{LOSSES_ALLOWED} worker processes were lost with the same work, {how}")
