"""A moment of a run: how things stood, what a decider had been told, and what the ledger had recorded."""

from bisect import bisect_right
from operator import itemgetter

import msgspec

from fsar_ledger import printable
from fsar_ledger.analysis.beliefs import Belief, beliefs
from fsar_ledger.analysis.moments import Timeline
from fsar_ledger.analysis.records import commits_of, record_of
from fsar_ledger.analysis.standing import Standing, standing
from fsar_ledger.errors import UsageError, option
from fsar_ledger.ledger.chain.read import View
from fsar_ledger.projections.fold import State

from .provenance import Provenance, of_run


class Moment(msgspec.Struct, frozen=True, kw_only=True):
    """How things stood in a run at a time.

    `seq` is the last event that had happened by then, and `event_s` its time; `ends_s` that of the last of the run.
    `commit` is the commit of the ledger, from 1, that recorded the run. `beliefs` are what a decider had been told,
    None unless asked for. `state` are the projections themselves. Units: seconds of run time.
    """

    run: str
    at_s: float
    seq: int
    event_s: float
    ends_s: float
    commit: int
    standing: Standing
    beliefs: list[Belief] | None
    state: State
    provenance: Provenance


def moment(
    view: View,
    provenance: Provenance,
    run: str,
    at_us: int | None,
    robot: str | None,
    as_known_by: str | None,
    by_commit: int | None,
) -> Moment:
    """Return the moment of a run of this ledger.

    Raises:
        UsageError: The ledger did not hold the run after that commit, or there is no such decider.
    """
    commits = len(view.commits)
    found = commits_of(view, run)
    if by_commit is not None:
        if not 0 <= by_commit <= commits:
            raise UsageError(f"{option('by_commit', by_commit)}: expected 0 to {commits}, the commits of the ledger")
        if by_commit < (commit := found[0][1] + 1):
            raise UsageError(
                f"{option('by_commit', by_commit)}: by then the ledger had recorded nothing of run "
                f"{printable.value(run)}, which came with commit {commit}"
            )
    timeline = Timeline(record_of(view, run, None if by_commit is None else view.commits[by_commit - 1].tree_size))
    times_us = timeline.record.times_us
    at_us = times_us[-1] if at_us is None else at_us
    seq = timeline.seq_at(at_us)
    state = timeline.after(seq)
    known = None if as_known_by is None else beliefs(timeline.record, seq, state, as_known_by)
    stands = standing(timeline.record, seq, state, robot)
    return Moment(
        run=run,
        at_s=at_us / 1e6,
        seq=seq,
        event_s=times_us[seq] / 1e6,
        ends_s=times_us[-1] / 1e6,
        commit=found[bisect_right(found, seq, key=itemgetter(0)) - 1][1] + 1,
        standing=stands,
        beliefs=known,
        state=state,
        provenance=of_run(provenance, stands.not_observed),
    )
