"""The handler table of a run: its architecture's, without the mechanisms that its configuration lacks."""

from functools import lru_cache
from importlib import import_module

from fsar_ledger.events.configuration import FULL, MECHANISMS, Configuration, lacks

from .architectures.handler_table import HandlerTable


def handler_table_of(architecture: str, configuration: Configuration = FULL) -> HandlerTable:
    """Return the architecture's handlers and reactions, without the mechanisms that the configuration lacks.

    The handlers themselves check the mechanisms of the paper's ablation, so those leave the table unchanged.
    """
    module = import_module(f".architectures.{architecture}", __package__)
    table: HandlerTable = getattr(module, architecture.upper())
    return table if lacks(configuration) <= set(MECHANISMS) else _knocked_out(architecture, configuration)


@lru_cache(maxsize=32)
def _knocked_out(architecture: str, configuration: Configuration) -> HandlerTable:
    """Return the table from a cache, so that the kernel plans it once for all runs."""
    from .knockouts import knock_out

    return knock_out(handler_table_of(architecture), architecture, configuration)
