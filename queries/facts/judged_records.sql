-- Title: The event types and fields that each judgement rests on, for runs that declare which of them they record
-- Paper: sec:evaluation:metrics, sec:model:invariants, sec:architecture:invariants
-- Grain: one row per judge and record (an event type without its version, or TYPE.FIELD), and per record beside it
-- Key: judge, record, beside?
-- Units: none; the absence of context would make an offence; a case (*) is what is judged; A>B: B, where A is recorded
-- NULL: beside where the record is always needed; else it is needed only with that one, as a field is with its type
-- Example: fsar-ledger query facts/judged_records LEDGER
WITH judges (judges, entries) AS (
    VALUES
    ('i1_local_agent_coherence', 'RobotJoined RobotDeparted* RobotDeparted>RobotReturned* AuthorityClaimed.fence*'),
    (
        'i2_local_execution_ownership',
        'ExecutionStarted* RequestAccepted RequestAccepted.decided_by RequestAccepted.executed_by
        ExecutionStarted.executed_by ExecutionStarted.on_behalf_of AuthorityRevoked* AuthorityRevoked>AuthorityGranted
        AuthorityRevoked>RequestAdmitted* AuthorityRevoked>RequestIssued*'
    ),
    (
        'i3_jointly_composed_policy a3_no_silent_policy_override',
        'ExecutionStarted* PolicyWindowOpened* PolicyRuleSet* RolePolicyRuleSet* RobotJoined* FleetRuleLearned*
        RequestDenied* RequestDenied.action_id* RequestDenied.executed_by RequestIssued* RequestIssued.carried_policy*
        RequestIssued.action_id RequestRelayed* RequestRelayed>RequestIssued RequestDenied>RequestAdmitted
        RequestDenied>RequestAdmitted.action_id RequestDenied>SupervisorResponded PolicyWindowOpened>PolicyWindowClosed
        ExecutionHeld>SupervisorResponded ExecutionHeld>PolicyWindowClosed ExecutionHeld>FleetRuleLearned
        ExecutionHeld>PolicyRuleSet ExecutionHeld>RolePolicyRuleSet'
    ),
    ('a3_no_silent_policy_override', 'PolicyRuleSet>PolicyConflictEscalated RequestAdmitted>SupervisorResponded'),
    ('a3_no_silent_policy_override', 'ExecutionHeld*'),
    (
        'i4_outward_recovery', 'FailureResolved* ExecutionFailed RecoveryAttempted RecoveryAttemptFailed*
        RecoveryEscalated AssistanceRequested AssistanceAdmitted AssistanceEnded ReassignmentDecided
        ReassignmentDecided.helper SupervisorCalled* SupervisorResponded RecoveryBudgetSet>RecoveryEscalated.reason'
    ),
    (
        'i5_audit_attributability audit_attributability', 'RobotJoined RobotJoined.supervisor SupervisorLeft
        SupervisorReturned GapDetected.action_id GapDetected>RequestIssued RegistryQueried.action_id
        RegistryQueried>RequestIssued RequestAdmitted.action_id RequestIssued.action_id RequestIssued>RequestAccepted
        RequestIssued>RequestUnanswered RequestIssued>RequestClosed'
    ),
    (
        'a1_local_runtime_self_sufficiency', 'ExecutionStarted* OwnStepDecided OwnStepDecided.decided_by
        OwnStepDecided.executed_by RoutinePerformed.decided_by RoutineWithheld.decided_by ExecutionStarted.on_behalf_of'
    ),
    ('i5_audit_attributability a2_coordination_only_federation', 'ExecutionStarted*'),
    (
        'a4_thin_federation_interface',
        'RequestAccepted* RequestAccepted.decided_by RequestAccepted.executed_by RequestAdmitted.decided_by
        RequestAdmitted.executed_by OwnStepDecided.decided_by OwnStepDecided.executed_by RoutinePerformed.decided_by
        RoutineWithheld.decided_by ExecutionHeld.decided_by ReplanOrdered.decided_by ReplanOrdered.executed_by
        AssistanceAdmitted.decided_by RecoveryAttempted.decided_by'
    ),
    (
        'a5_audit_completeness',
        'ExecutionFinished* ExecutionStarted ExecutionStarted.on_behalf_of RequestIssued RequestIssued.action_id
        RequestIssued.request_id RequestAdmitted RequestAdmitted.action_id RequestAccepted RequestClosed
        ReassignmentDecided ReassignmentDecided.helper RobotJoined RobotJoined.supervisor SupervisorLeft
        SupervisorReturned ExecutionStarted.requested_by ExecutionStarted.executed_by ExecutionStarted.supervised_by
        ExecutionFinished.requested_by ExecutionFinished.executed_by ExecutionFinished.supervised_by
        AssistanceAdmitted.requested_by AssistanceAdmitted.executed_by AssistanceAdmitted.supervised_by'
    )
),

listed AS (
    SELECT judges, unnest(regexp_split_to_array(entries, '\s+')) AS entry FROM judges
    UNION ALL
    SELECT judge AS judges, record AS entry FROM metric_records
    UNION ALL -- the principals of a record are judged wherever its type is recorded; the end of its request names them
    SELECT
        'i5_audit_attributability audit_attributability' AS judges,
        split_part(type, '.', 1) || '.' || unnest(['requested_by', 'executed_by', 'supervised_by']) AS entry
    FROM event_classes
    WHERE record_kind IS NOT NULL OR type = 'RequestClosed.v1'
)

SELECT DISTINCT
    unnest(string_split(judges, ' ')) AS judge, rtrim(string_split(entry, '>')[-1], '*') AS record,
    nullif(if(contains(entry, '>'), string_split(entry, '>')[1], regexp_extract(entry, '^(\w+)\.', 1)), '') AS beside,
    NOT ends_with(entry, '*') AS is_context
FROM listed
