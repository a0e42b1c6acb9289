-- Title: Events of the types that have a field for a robot or a principal, and whom each names
-- Paper: sec:model:invariants (I1)
-- Grain: one row per event of such a type
-- Key: run_id, seq
-- Units: time_us microseconds of run time; names_somebody whether a principal or the executing robot is named
-- NULL: the event's type has no such field, or the record does not name it
-- Example: fsar-ledger query facts/naming_events LEDGER
-- The excluded types are listed, so that the columns of their events are not read. The executor is the robot, since a
-- record of an execution may leave executed_by out.
SELECT
    run_id, seq, time_us, type, action_id, robot, on_behalf_of, decided_by, requested_by, executed_by, supervised_by,
    claimant, sender, receiver, path,
    if(type IN ('ExecutionStarted.v1', 'ExecutionFinished.v1'), robot, NULL) AS executor,
    decided_by IS NOT NULL OR requested_by IS NOT NULL OR executed_by IS NOT NULL OR supervised_by IS NOT NULL
    OR claimant IS NOT NULL OR sender IS NOT NULL OR receiver IS NOT NULL OR coalesce(len(path) > 0, FALSE)
    OR executor IS NOT NULL
        AS names_somebody
FROM event_principals
WHERE
    type NOT IN (
        'RunStarted.v2', 'ExperimentPlanned.v1', 'SyncPhaseSet.v1', 'SupervisorLeft.v1', 'SupervisorReturned.v1',
        'StepCompleted.v1', 'TaskCompleted.v1', 'TaskAbandoned.v1', 'RegistryCached.v1', 'CopySynced.v1',
        'WorkQueued.v1', 'CommandGiven.v1', 'CommandRejected.v1', 'TaskPlanned.v1', 'SourceOpened.v1', 'Observed.v1',
        'RunContinued.v1', 'ShardRecorded.v1',
        'SourceClosed.v1'
    )
