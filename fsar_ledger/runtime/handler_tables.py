"""The handler table that a run is played with: its architecture's, without what its configuration lacks."""

from functools import lru_cache
from importlib import import_module

from fsar_ledger.events.configuration import FULL, MECHANISMS, Configuration, lacks

from .architectures.handler_table import HandlerTable


def handler_table_of(architecture: str, configuration: Configuration = FULL) -> HandlerTable:
    """Return the architecture's handlers and reactions, without what the configuration lacks.

    The handlers check the mechanisms of the paper's ablation themselves, so these leave the table as it is.
    """
    module = import_module(f".architectures.{architecture}", __package__)
    table: HandlerTable = getattr(module, architecture.upper())
    return table if lacks(configuration) <= set(MECHANISMS) else _knocked_out(architecture, configuration)


@lru_cache(maxsize=32)
def _knocked_out(architecture: str, configuration: Configuration) -> HandlerTable:
    """Return one object for all runs, so that the kernel plans it once."""
    from .knockouts import knock_out

    return knock_out(handler_table_of(architecture), architecture, configuration)
