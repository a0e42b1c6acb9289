"""What a run says that its source records: concerns, event types and fields."""

from collections.abc import Collection, Iterable

import msgspec

from fsar_ledger.base.errors import UsageError
from fsar_ledger.base.printable import did_you_mean, value
from fsar_ledger.events import CONCERN_OF, CONCERNS
from fsar_ledger.ledger.rows.schema import RECORDS


# See docs/decisions/sources-are-judged-by-types.md.
class Declared(msgspec.Struct, frozen=True):
    """What a source records: everything of the concerns it `observes`, and of others the `records` it names.

    `kinds` are the event types that the run may have.
    """

    observes: tuple[str, ...]
    records: tuple[str, ...]

    @property
    def kinds(self) -> frozenset[str]:
        """The event types, by name without version, that the run may have beside those that say what it is."""
        whole = {kind for kind, concern in CONCERN_OF.items() if concern in self.observes}
        return frozenset(whole | {name for name in self.records if "." not in name})


def declared(names: Iterable[str]) -> Declared:
    """Return what these names declare: concerns, event types, and fields such as `RequestIssued.requested_by`.

    `RequestIssued.*` is the type with all of its fields. Each is named once, in the order of `CONCERNS` and of the
    event types. Naming a field names its type.

    Raises: UsageError for a name that is none of these.
    """
    asked = {
        one
        for name in names
        for one in ([each for each in RECORDS if each.startswith(name[:-1])] if name.endswith(".*") else [name])
    }
    asked |= {name.partition(".")[0] for name in asked if "." in name}
    known: Collection[str] = (*CONCERNS, *RECORDS)
    for name in sorted(asked - set(known)):
        raise UsageError(
            f"observes: found {value(name)}, expected concerns ({', '.join(CONCERNS)}), event types, or fields of them "
            f"that may be NULL, as in ExecutionStarted.requested_by{did_you_mean(name, known)}"
        )
    return Declared(tuple(name for name in CONCERNS if name in asked), tuple(name for name in RECORDS if name in asked))
