-- Title: How each event type reads that no timeline of a request tells: who does what, in which words
-- Paper: sec:model, sec:evaluation:simulator
-- Grain: one row per event type
-- Key: type
-- Units: none
-- NULL: detail when the words say everything; otherwise the field whose value follows them
-- Example: fsar-ledger query facts/occurrence_words LEDGER
-- A claim of authority that revokes nothing reads as here; one that does is in message_words.
WITH words (type, sender, receiver, words, detail) AS (
    VALUES
    ('RunStarted.v2', 'run', 'run', 'begins', 'begins'),
    ('ExperimentPlanned.v1', 'experiment', 'experiment', 'is planned', 'planned'),
    ('RobotJoined.v1', 'robot', 'robot', 'joins the fleet as', 'role'),
    ('CapabilityInstalled.v1', 'robot', 'robot', 'installs', 'capability'),
    ('CapabilityRemoved.v1', 'robot', 'robot', 'removes', 'capability'),
    ('CapabilityAdvertised.v1', 'robot', 'robot', 'advertises', 'capability'),
    ('CapabilityWithdrawn.v1', 'robot', 'robot', 'withdraws', 'capability'),
    ('CapabilityDeprecated.v1', 'robot', 'robot', 'phases out', 'capability'),
    ('AvailabilityChanged.v1', 'robot', 'robot', 'availability', 'availability'),
    ('RegistryCached.v1', 'holder', 'holder', 'copies the registry', NULL),
    ('RegistryConsulted.v1', 'requester', 'registry', 'consult', 'capability'),
    ('TrustSet.v1', 'robot', 'peer', 'trust', 'scope'),
    ('RoleTrustSet.v1', 'role', 'peer_role', 'trust', 'scope'),
    ('InitialTrustSet.v1', 'robot', 'robot', 'joins with initial trust', 'scope'),
    ('TrustThresholdsSet.v1', 'decider', 'decider', 'sets how trust follows the record', 'thresholds'),
    ('PolicyRuleSet.v1', 'robots', 'robots', 'policy rule', 'rule'),
    ('RolePolicyRuleSet.v1', 'role', 'role', 'policy rule', 'rule'),
    ('PolicyWindowOpened.v1', 'robot', 'robot', 'policy window opens', 'window'),
    ('PolicyWindowClosed.v1', 'robot', 'robot', 'policy window closes', 'window'),
    ('SyncPhaseSet.v1', 'robots', 'robots', 'clock of exchanges', 'phase'),
    ('SnapshotPhaseSet.v1', 'robot', 'robot', 'clock of refreshes', 'phase'),
    ('ContextChanged.v1', 'robot', 'robot', 'situation changes', NULL),
    ('ObstructionAppeared.v1', 'robot', 'robot', 'is obstructed', 'obstruction'),
    ('ObstructionCleared.v1', 'robot', 'robot', 'is free again', 'obstruction'),
    ('ActuatorDegraded.v1', 'robot', 'robot', 'actuator degrades', 'grade'),
    ('ActuatorServiced.v1', 'robot', 'robot', 'actuator is repaired', NULL),
    ('RobotWentOff.v1', 'robot', 'robot', 'goes off', NULL),
    ('RobotCameBack.v1', 'robot', 'robot', 'comes back', NULL),
    ('LinkWentDown.v1', 'robot', 'robot', 'link goes down', NULL),
    ('LinkCameUp.v1', 'robot', 'robot', 'link comes up', NULL),
    ('PeersMet.v1', 'robot', 'robot', 'meets', 'peer'),
    ('PeerRemembered.v1', 'robot', 'robot', 'remembers', 'peer'),
    ('SupervisorLeft.v1', 'on_shift', 'on_shift', 'goes off shift', NULL),
    ('SupervisorReturned.v1', 'on_shift', 'on_shift', 'is back on shift', NULL),
    ('SupervisionDensitySet.v1', 'decider', 'robots', 'sets supervision', 'density'),
    ('TaskArrived.v1', 'robot', 'robot', 'receives task', 'task'),
    ('TaskPlanned.v1', 'coordinator', 'coordinator', 'plans task', 'task'),
    ('StepBegan.v1', 'robot', 'robot', 'turns to', 'capability'),
    ('StepCompleted.v1', 'task', 'task', 'step is done', NULL),
    ('SegmentTransferred.v1', 'decider', 'robot', 'gives the task on', NULL),
    ('TaskCompleted.v1', 'task', 'task', 'is completed', NULL),
    ('TaskAbandoned.v1', 'task', 'task', 'is given up', NULL),
    ('AuthorityClaimed.v1', 'claimant', 'claimant', 'claims authority', 'dimension'),
    ('AuthorityReleased.v1', 'claimant', 'claimant', 'releases authority', 'dimension'),
    ('AuthorityGranted.v1', 'decider', 'requester', 'allows requests', 'granted'),
    ('AuthorityRevoked.v1', 'decider', 'requester', 'allows no more requests', 'reason'),
    ('ExecutionQueued.v1', 'robot', 'robot', 'queues', 'capability'),
    ('RoutineDue.v1', 'robot', 'robot', 'is due for routine', 'operation'),
    ('RoutinePerformed.v1', 'robot', 'robot', 'performs routine', 'operation'),
    ('RoutineWithheld.v1', 'robot', 'robot', 'withholds routine', 'operation'),
    ('RoutineReported.v1', 'robot', 'robot', 'reports routine motion', NULL),
    ('RecoveryBudgetSet.v1', 'decider', 'robot', 'sets recovery budget', 'budget'),
    ('FleetRuleLearned.v1', 'robot', 'robot', 'learns the rule of the fleet', 'outcome'),
    ('SnapshotTaken.v1', 'robot', 'robot', 'refreshes its policy snapshot', 'outcome'),
    ('CopySynced.v1', 'coordinator', 'coordinator', 'refreshes its copy of all robots', NULL),
    ('WorkQueued.v1', 'coordinator', 'coordinator', 'queues', 'item'),
    ('StoreEntryWritten.v1', 'robot', 'robot', 'is shown in the store', 'availability'),
    ('BidReceived.v1', 'robot', 'robot', 'bid is read', 'outcome'),
    ('PlannerEngaged.v1', 'robot', 'robot', 'planner is engaged', NULL),
    ('MotivationBegan.v1', 'robot', 'robot', 'senses a need', NULL),
    ('ActivityBroadcast.v1', 'robot', 'robot', 'says that it is active', NULL),
    ('ActivityHeard.v1', 'peer', 'robot', 'is heard to be active', NULL),
    ('NeedEnded.v1', 'peer', 'robot', 'is heard to be done', 'capability'),
    ('CommandRejected.v1', 'issuer', 'issuer', 'command rejected', 'command')
)

SELECT *
FROM words
