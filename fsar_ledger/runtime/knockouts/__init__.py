"""Takes out mechanisms, to show which number each of them carries.

A knockout changes decisions of one architecture and leaves the world as it is. The handlers themselves check the four
mechanisms of the paper's ablation; the replacements of all others are here. A configuration loses only the mechanisms
that it names.
"""

from fsar_ledger.events.configuration import MECHANISMS_OF, Configuration, lacks
from fsar_ledger.events.envelope import Architecture
from fsar_ledger.runtime.architectures.handler_table import HandlerTable

from . import cfc, dhma, fsar
from .knockout import Knockout

KNOCKOUTS: tuple[Knockout, ...] = fsar.KNOCKOUTS + cfc.KNOCKOUTS + dhma.KNOCKOUTS
assert {(one.architecture, one.name) for one in KNOCKOUTS} == {
    (architecture, name) for architecture, names in MECHANISMS_OF.items() for name in names
}


def knock_out(table: HandlerTable, architecture: Architecture, configuration: Configuration) -> HandlerTable:
    """Return the architecture's table without what the configuration lacks, except what its handlers check."""
    for knockout in KNOCKOUTS:
        if knockout.architecture == architecture and knockout.name in lacks(configuration):
            table = knockout.taken_out_of(table)
    return table
