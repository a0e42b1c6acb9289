"""The eight metrics in Polars, by the judging rules of `queries/metrics`: what the SQL is measured against."""

from typing import NamedTuple

import polars as pl

from fsar_ledger.events import EVENT_TYPES

GROUP = ["architecture", "configuration", "fleet_size"]
ACTION = ["run_id", "action_id"]
FAILURE = ["run_id", "action_id", "failure"]
PRINCIPALS = ["requested_by", "executed_by", "supervised_by"]
TAGS = {kind.__name__: str(kind.__struct_config__.tag) for kind in EVENT_TYPES}


class EventClasses(NamedTuple):
    """The event types by what they are to a judge, from the SQL's own table, so that both sides agree.

    `of_requesters` are those that tell the requester's part in an action; all others of `judged` tell the executor's.
    `requiring` are, by principal, those whose records are incomplete without it.
    """

    judged: list[str]
    decisions: list[str]
    denials: list[str]
    records: list[str]
    of_requesters: list[str]
    requiring: dict[str, list[str]]


def of(events: pl.LazyFrame, *types: str) -> pl.LazyFrame:
    return events.filter(pl.col("type").is_in([TAGS[name] for name in types]))


def success(events: pl.LazyFrame) -> pl.LazyFrame:
    done = of(events, "TaskCompleted").group_by("run_id", "task_id").agg(pl.col("time_us").min().alias("done_us"))
    in_time = (pl.col("done_us") - pl.col("time_us") <= pl.col("budget_us")).fill_null(value=False)
    tasks = (
        of(events, "TaskArrived")
        .select("run_id", "task_id", "time_us", "budget_us")
        .join(done, on=["run_id", "task_id"], how="left")
    )
    return tasks.group_by("run_id").agg(in_time.mean().alias("coordination_success"))


def locality(events: pl.LazyFrame, classes: EventClasses) -> pl.LazyFrame:
    is_local = (pl.col("path").list.len() == 1) & pl.col("decided_by").str.contains("^(robot|supervisor)/").fill_null(
        value=False
    )
    content = [pl.col("type", "decided_by", "reason"), pl.col("path").list.join(">")]
    decisions = events.filter(pl.col("type").is_in(classes.decisions)).filter(pl.col("path").list.len() > 0)
    is_new = pl.any_horizontal(
        one.ne_missing(one.shift(1).over("run_id", "task_id", order_by="seq")) for one in content
    )
    is_decision = ~pl.col("type").is_in(classes.denials) | pl.col("task_id").is_null() | is_new
    return decisions.filter(is_decision).group_by("run_id").agg(is_local.mean().alias("governance_locality"))


def failures(events: pl.LazyFrame) -> pl.LazyFrame:
    """Count per run the failures, the contained ones and those with a latency, and sum the latencies."""
    resolved = (
        of(events, "FailureResolved")
        .group_by(FAILURE)
        .agg(pl.col("time_us").min().alias("resolved_us"), pl.col("level").sort_by("seq").first())
    )
    left = of(events, "RecoveryEscalated", "AssistanceRequested").group_by(
        "run_id", pl.col("failed_action").alias("action_id"), "failure"
    )
    found = of(events, "ExecutionFailed").select(*FAILURE, "time_us").join(resolved, on=FAILURE, how="left")
    found = found.join(left.agg(pl.col("time_us").min().alias("left_us")), on=FAILURE, how="left")
    latency_us = pl.when(pl.col("level") == "local").then("resolved_us").otherwise("left_us") - pl.col("time_us")
    contained = pl.col("level").is_in(["local", "peer"]).fill_null(value=False)
    return found.group_by("run_id").agg(
        pl.len().alias("failures"),
        contained.sum().alias("contained"),
        latency_us.count().alias("timed"),
        latency_us.sum().alias("latency_us"),
    )


def conflicts(events: pl.LazyFrame) -> pl.LazyFrame:
    subject = [*ACTION, "dimension"]
    is_release = pl.col("type") == TAGS["AuthorityReleased"]
    ended_us = pl.when(is_release).then("time_us").shift(-1).backward_fill().over([*subject, "claimant", "reason"])
    edges = of(events, "AuthorityClaimed", "AuthorityReleased").select(
        "type", "time_us", *subject, "claimant", "reason"
    )
    held = edges.with_columns(ended_us.fill_null(2**62).alias("ended_us")).filter(
        ~is_release & (pl.col("ended_us") > pl.col("time_us"))
    )
    pairs = held.join(held, on=subject, how="inner").filter(
        (pl.col("claimant") < pl.col("claimant_right"))
        & (pl.col("time_us") < pl.col("ended_us_right"))
        & (pl.col("time_us_right") < pl.col("ended_us"))
    )
    return pairs.select(subject).unique().group_by("run_id").agg(pl.len().alias("authority_conflicts"))


def violations(events: pl.LazyFrame) -> pl.LazyFrame:
    key = ["run_id", "robot", "scope", "window"]
    closed = of(events, "PolicyWindowClosed").group_by(key).agg(pl.col("time_us").min().alias("closed_us"))
    windows = (
        of(events, "PolicyWindowOpened")
        .select(*key, "outcome", pl.col("time_us").alias("opened_us"))
        .join(closed, on=key, how="left")
    )
    is_motion = (pl.col("type") == TAGS["RoutinePerformed"]) & (pl.col("operation") == "motion")
    starts = of(events, "ExecutionStarted", "RoutinePerformed").filter(
        (pl.col("type") == TAGS["ExecutionStarted"]) | is_motion
    )
    starts = starts.select(*ACTION, "seq", "time_us", "robot", "on_behalf_of")
    own = starts.join(windows, on=["run_id", "robot"], how="inner")
    requester = starts.join(
        windows.filter(pl.col("scope") == "local"),
        left_on=["run_id", "on_behalf_of"],
        right_on=["run_id", "robot"],
        how="inner",
    )
    columns = [*ACTION, "seq", "time_us", "outcome", "opened_us", "closed_us"]
    is_open = (pl.col("time_us") >= pl.col("opened_us")) & (pl.col("time_us") < pl.col("closed_us").fill_null(2**62))
    hits = pl.concat([own.select(columns), requester.select(columns)]).filter(is_open)
    hits = hits.group_by(*ACTION, "seq").agg((pl.col("outcome") == "deny").any().alias("is_denied"))
    reviews = (
        of(events, "SupervisorResponded")
        .filter(pl.col("purpose") == "review")
        .group_by(ACTION)
        .agg(pl.col("seq").min().alias("approved_seq"))
    )
    is_approved = (pl.col("approved_seq") < pl.col("seq")).fill_null(value=False)
    judged = hits.join(reviews, on=ACTION, how="left").filter(pl.col("is_denied") | ~is_approved)
    return judged.group_by("run_id").agg(pl.len().alias("policy_violations"))


def human(events: pl.LazyFrame) -> pl.LazyFrame:
    called = of(events, "SupervisorCalled").filter(pl.col("supervisor") == "supervisor/fleet")
    return called.select("run_id").unique().with_columns(human_intervention=pl.lit(1))


def attributability(events: pl.LazyFrame, classes: EventClasses) -> pl.LazyFrame:
    decider = "robot/" + pl.col("decided_by").str.extract("^(?:robot|agent)/([^/]+)")
    executor = pl.coalesce("executed_by", "robot", decider, "requested_by")
    part = pl.when(pl.col("type").is_in(classes.of_requesters)).then("requested_by").otherwise(executor)
    judged = events.filter(pl.col("type").is_in(classes.judged)).with_columns(part=part)
    known = judged.group_by(*ACTION, "part").agg(
        pl.col(name).is_not_null().any().alias(f"has_{name}") for name in PRINCIPALS
    )
    records = judged.filter(pl.col("type").is_in(classes.records)).join(known, on=[*ACTION, "part"], how="left")
    told = {name: pl.col(name).is_not_null() | pl.col(f"has_{name}").fill_null(value=False) for name in PRINCIPALS}
    told["supervised_by"] |= pl.col("is_off_shift")
    complete = pl.all_horizontal(told[name] | ~pl.col("type").is_in(types) for name, types in classes.requiring.items())
    return off_shift(events, records).group_by("run_id").agg(complete.mean().alias("audit_attributability"))


def off_shift(events: pl.LazyFrame, records: pl.LazyFrame) -> pl.LazyFrame:
    """Say of each record whether the supervisor of the robot whose part it tells is off shift."""
    members = of(events, "RobotJoined").select(
        "run_id", pl.col("robot").alias("part"), pl.col("supervisor").alias("of")
    )
    shifts = of(events, "SupervisorLeft", "SupervisorReturned").select(
        "run_id", "seq", pl.col("supervisor").alias("of"), is_off_shift=pl.col("type") == TAGS["SupervisorLeft"]
    )
    return (
        records.drop("supervisor", strict=False)
        .join(members, on=["run_id", "part"], how="left")
        .sort("seq")
        .join_asof(shifts.sort("seq"), on="seq", by=["run_id", "of"], allow_exact_matches=False, check_sortedness=False)
        .with_columns(pl.col("is_off_shift").fill_null(value=False))
    )


def eight_metrics(events: pl.LazyFrame, classes: EventClasses) -> pl.DataFrame:
    """Average each metric by architecture, configuration and fleet size, with failures pooled over runs."""
    runs = of(events, "RunStarted").select("run_id", *GROUP)
    parts = pl.collect_all(
        [
            runs,
            success(events),
            locality(events, classes),
            failures(events),
            conflicts(events),
            violations(events),
            human(events),
            attributability(events, classes),
        ]
    )
    table = parts[0]
    for part in parts[1:]:
        table = table.join(part, on="run_id", how="left")
    plain = ("coordination_success", "governance_locality", "audit_attributability")
    counts = ("authority_conflicts", "policy_violations", "human_intervention")
    return table.group_by(GROUP).agg(
        *(pl.col(name).mean() for name in plain),
        *(pl.col(name).fill_null(0).mean() for name in counts),
        (pl.col("contained").sum() / pl.col("failures").sum()).alias("recovery_containment"),
        (pl.col("latency_us").sum() / pl.col("timed").sum() / 1e6).alias("reassignment_latency_s"),
    )
