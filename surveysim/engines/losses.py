"""What happens to an engine that loses workers."""

import logging

LOSSES_ALLOWED = 3  # of the workers that had an item: one that kills them all is the reason itself

log = logging.getLogger("surveysim")


class EngineError(RuntimeError):
    """An engine that can't go on: its workers or its scheduler are gone, or can't be used; the text says which."""


def too_many_losses() -> EngineError:
    """The error of an item whose workers are gone again and again."""
    return EngineError(
        f"a worker process is gone {LOSSES_ALLOWED} times with the same work, perhaps killed for want of memory"
    )
