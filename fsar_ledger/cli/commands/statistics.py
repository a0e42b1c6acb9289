"""The command `statistics`."""

import typer

from fsar_ledger import printable
from fsar_ledger.cli.options import (
    CsvOption,
    JsonOption,
    LedgerArgument,
    PoolOption,
    RawOption,
    VerifiedOption,
    WideOption,
    examples,
)
from fsar_ledger.cli.terminal import say, show

EXAMPLES = examples("fsar-ledger statistics out/ledger", "fsar-ledger statistics out/ledger --csv")


def statistics(
    ledger: LedgerArgument,
    pool: PoolOption = None,
    verified: VerifiedOption = False,
    as_json: JsonOption = False,
    as_csv: CsvOption = False,
    raw: RawOption = False,
    wide: WideOption = False,
) -> None:
    """Compare the architectures of a ledger in pairs, and FSAR with itself without a mechanism.

    For each metric and pair: paired t, Wilcoxon signed-rank, effect sizes, exact McNemar for human intervention, and
    Holm over the 24 tests of the architectures, or over those of all ablations. Runs that did not meet the same world
    are named first and left out; exit code 1 where facts differ that an experiment keeps alike. The answer says what
    cannot be compared, and why. A run without failures counts as in the paper (containment 1, latency 0 s); `query
    statistics/all_pairwise_tests` also has the tests without such pairs (basis defined). The columns pooled_* test what
    the results table prints: containment and latency pooled over failures.
    """
    from fsar_ledger.api.fields import csv_text
    from fsar_ledger.cli.answering import opened, warn
    from fsar_ledger.cli.output import answer_json, check_form, telling, unit_of_interventions
    from fsar_ledger.cli.tables import is_fitted, table

    check_form(as_json=as_json, as_csv=as_csv, raw=raw)
    found = opened(ledger, verified=verified).statistics(pool)  # type: ignore[arg-type]  # it refuses any other text
    if as_json:
        document = {
            "rows": found.rows,
            "differing_worlds": found.differing,
            "not_compared": found.not_compared,
            "remarks": [*found.remarks, *found.notes],
        }
        show(answer_json(found.provenance, document))
    elif as_csv:
        say(*found.before, *found.after)
        show(csv_text(found.rows, found.columns, raw=raw), raw=raw)
    else:
        shown = table(found.rows, telling(found.rows), wide=wide) if found.rows else printable.lines()
        above = [*found.before, *([""] if found.before and found.rows else [])]
        below = ["", *found.after, *found.notes] if found.after or found.notes else []
        show(printable.joined(printable.lines(*above), shown, printable.lines(*below)))
        if is_fitted(wide=wide):
            show(unit_of_interventions(ledger))
    warn(ledger, found.provenance)
    if any(one.is_fault for one in found.differing):
        raise typer.Exit(1)
