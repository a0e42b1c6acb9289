-- Title: The wording of each event type that is in no timeline of a request: who does what
-- Paper: sec:model, sec:evaluation:simulator
-- Grain: one row per event type
-- Key: type
-- Units: none
-- NULL: detail when the words are complete; otherwise the field whose value follows them
-- Example: fsar-ledger query facts/occurrence_words LEDGER
-- A claim of authority that revokes nothing is worded here; one that does, in message_words.
SELECT told.type, told.sender, told.receiver, told.words, told.detail
FROM (
    VALUES
    ('RunStarted.v2', 'run', 'run', 'begins', 'begins'), ('RunContinued.v1', 'run', 'run', 'goes on from', 'from'),
    ('ExperimentPlanned.v1', 'experiment', 'experiment', 'is planned', 'planned'),
    ('ShardRecorded.v1', 'federation', 'federation', 'records the head of a shard', NULL),
    ('HeartbeatReceived.v1', 'robot', 'registry', 'is there', NULL),
    ('RegistryCached.v1', 'holder', 'holder', 'copies the registry', NULL),
    ('RegistryConsulted.v1', 'requester', 'registry', 'consult', 'capability'),
    ('TrustSet.v1', 'robot', 'peer', 'trust', 'scope'), ('RoleTrustSet.v1', 'role', 'peer_role', 'trust', 'scope'),
    ('TrustThresholdsSet.v1', 'decider', 'decider', 'sets how trust follows the record', 'thresholds'),
    ('PolicyRuleSet.v1', 'robots', 'robots', 'policy rule', 'rule'),
    ('RolePolicyRuleSet.v1', 'role', 'role', 'policy rule', 'rule'),
    ('SyncPhaseSet.v1', 'robots', 'robots', 'clock of exchanges', 'phase'),
    ('SupervisorLeft.v1', 'on_shift', 'on_shift', 'goes off shift', NULL),
    ('SupervisorReturned.v1', 'on_shift', 'on_shift', 'is back on shift', NULL),
    ('SupervisionDensitySet.v1', 'decider', 'robots', 'sets supervision', 'density'),
    ('TaskPlanned.v1', 'coordinator', 'coordinator', 'plans task', 'task'),
    ('StepCompleted.v1', 'task', 'task', 'step is done', NULL),
    ('SegmentTransferred.v1', 'decider', 'robot', 'gives the task on', NULL),
    ('TaskCompleted.v1', 'task', 'task', 'is completed', NULL),
    ('TaskAbandoned.v1', 'task', 'task', 'is given up', NULL),
    ('AuthorityClaimed.v1', 'claimant', 'claimant', 'claims authority', 'dimension'),
    ('AuthorityReleased.v1', 'claimant', 'claimant', 'releases authority', 'dimension'),
    ('AuthorityGranted.v1', 'decider', 'requester', 'allows requests', 'granted'),
    ('AuthorityRevoked.v1', 'decider', 'requester', 'allows no more requests', 'reason'),
    ('RecoveryBudgetSet.v1', 'decider', 'robot', 'sets recovery budget', 'budget'),
    ('CopySynced.v1', 'coordinator', 'coordinator', 'refreshes its copy of all robots', NULL),
    ('WorkQueued.v1', 'coordinator', 'coordinator', 'queues', 'item'),
    ('ActivityHeard.v1', 'peer', 'robot', 'is heard to be active', NULL),
    ('NeedEnded.v1', 'peer', 'robot', 'is heard to be done', 'capability'),
    ('CommandGiven.v1', 'issuer', 'issuer', 'gives the command', 'command'),
    ('CommandRejected.v1', 'issuer', 'issuer', 'command rejected', 'command'),
    ('SourceOpened.v1', 'source', 'source', 'opens', 'format'), ('Observed.v1', 'source', 'source', 'says', 'kind'),
    ('SourceClosed.v1', 'source', 'source', 'has no more records', NULL)
) AS told (type, sender, receiver, words, detail)
UNION ALL
SELECT own.type, 'robot' AS sender, 'robot' AS receiver, own.words, own.detail
FROM (
    VALUES
    ('RobotDeparted.v1', 'departs', 'reason'), ('IsolationBegan.v1', 'goes on alone', 'from'),
    ('IsolationEnded.v1', 'is back', 'from'), ('IsolatedResultAccepted.v1', 'accepted', 'result'),
    ('IsolatedResultOvertaken.v1', 'overtaken', 'reason'), ('RobotJoined.v1', 'joins the fleet as', 'role'),
    ('RobotSuspected.v1', 'suspected', NULL), ('RobotReturned.v1', 'returns', NULL),
    ('RobotCalledAway.v1', 'is called away', NULL), ('CapabilityInstalled.v1', 'installs', 'capability'),
    ('CapabilityRemoved.v1', 'removes', 'capability'), ('CapabilityAdvertised.v1', 'advertises', 'capability'),
    ('CapabilityWithdrawn.v1', 'withdraws', 'capability'), ('CapabilityDeprecated.v1', 'phases out', 'capability'),
    ('AvailabilityChanged.v1', 'availability', 'availability'),
    ('InitialTrustSet.v1', 'joins with initial trust', 'scope'),
    ('PolicyWindowOpened.v1', 'policy window opens', 'window'),
    ('PolicyWindowClosed.v1', 'policy window closes', 'window'), ('SnapshotPhaseSet.v1', 'clock of refreshes', 'phase'),
    ('ContextChanged.v1', 'situation changes', NULL), ('ObstructionAppeared.v1', 'is obstructed', 'obstruction'),
    ('ObstructionCleared.v1', 'is free again', 'obstruction'), ('ActuatorDegraded.v1', 'actuator degrades', 'grade'),
    ('ActuatorServiced.v1', 'actuator is repaired', NULL), ('RobotWentOff.v1', 'goes off', NULL),
    ('RobotCameBack.v1', 'comes back', NULL), ('LinkWentDown.v1', 'link goes down', NULL),
    ('LinkCameUp.v1', 'link comes up', NULL), ('PeersMet.v1', 'meets', 'peer'),
    ('PeerRemembered.v1', 'remembers', 'peer'), ('TaskArrived.v1', 'receives task', 'task'),
    ('StepBegan.v1', 'turns to', 'capability'), ('RobotCleared.v1', 'cleared', NULL),
    ('ExecutionQueued.v1', 'queues', 'capability'), ('RoutineDue.v1', 'is due for routine', 'operation'),
    ('RoutinePerformed.v1', 'performs routine', 'operation'), ('RoutineWithheld.v1', 'withholds routine', 'operation'),
    ('RoutineReported.v1', 'reports routine motion', NULL),
    ('FleetRuleLearned.v1', 'learns the rule of the fleet', 'outcome'),
    ('SnapshotTaken.v1', 'refreshes its policy snapshot', 'outcome'),
    ('StoreEntryWritten.v1', 'is shown in the store', 'availability'), ('BidReceived.v1', 'bid is read', 'outcome'),
    ('PlannerEngaged.v1', 'planner is engaged', NULL), ('MotivationBegan.v1', 'senses a need', NULL),
    ('ActivityBroadcast.v1', 'says that it is active', NULL)
) AS own (type, words, detail)
