"""What a run may observe: the concerns, one word each, and the event types of each, whatever their version."""

from collections.abc import Mapping

EVENTS_OF: Mapping[str, tuple[str, ...]] = {
    # robots and their membership
    "fleet": ("RobotJoined",),
    # capabilities, advertisements, availability, look-ups
    "registry": (
        *(
            "CapabilityInstalled",
            "CapabilityRemoved",
            "CapabilityAdvertised",
            "CapabilityWithdrawn",
            "CapabilityDeprecated",
        ),
        *("AvailabilityChanged", "RegistryCached", "RegistryConsulted", "RegistryQueried"),
    ),
    "trust": ("TrustSet", "RoleTrustSet", "TrustThresholdsSet"),
    # rules and windows, a robot's own and the fleet's
    "policy": (
        "PolicyRuleSet",
        "RolePolicyRuleSet",
        "PolicyWindowOpened",
        "PolicyWindowClosed",
        "PolicyConflictEscalated",
    ),
    "task": ("TaskArrived", "StepBegan", "StepCompleted", "TaskCompleted", "TaskAbandoned"),
    # requests between robots, from the gap to the end, and how they are decided
    "request": (
        *(
            "GapDetected",
            "RequestIssued",
            "RequestRelayed",
            "RequestUnanswered",
            "PeerSought",
            "CandidateMatched",
            "BidSubmitted",
            "AwardMade",
        ),
        *(
            "RequestAdmitted",
            "RequestDenied",
            "RequestDeferred",
            "RequestCountered",
            "OfferAnswered",
            "CommandIssued",
            "RequestAccepted",
        ),
        *("ContractQuestioned", "ContractVoided", "RequestClosed"),
    ),
    # claims, grants, revocations
    "authority": ("AuthorityClaimed", "AuthorityReleased", "AuthorityGranted", "AuthorityRevoked"),
    # who does what, and routine
    "execution": (
        *(
            "OwnStepDecided",
            "ExecutionQueued",
            "ApproachStarted",
            "ExecutionHeld",
            "ExecutionStarted",
            "ExecutionPaused",
            "ExecutionPreempted",
        ),
        *(
            "ExecutionHalted",
            "ReplanOrdered",
            "ExecutionResumed",
            "ExecutionFinished",
            "ExecutionWithdrawn",
            "RoutinePerformed",
            "RoutineWithheld",
        ),
    ),
    # failures and what is done about them
    "recovery": (
        *(
            "ExecutionFailed",
            "RecoveryBudgetSet",
            "RecoveryAttempted",
            "RecoveryAttemptFailed",
            "RecoveryEscalated",
            "AssistanceRequested",
        ),
        *(
            "AssistanceAdmitted",
            "AssistanceDeclined",
            "AssistanceEnded",
            "AssistanceFailed",
            "ReassignmentDecided",
            "TaskStateTransferred",
        ),
        "FailureResolved",
    ),
    # supervisors: calls, answers, absences
    "supervision": (
        "SupervisorCalled",
        "SupervisorResponded",
        "SupervisionDensitySet",
        "ActuatorServiced",
        "SupervisorLeft",
        "SupervisorReturned",
    ),
    # what a decider has been told
    "knowledge": (
        "FleetRuleLearned",
        "PeerRemembered",
        "CopySynced",
        "SnapshotTaken",
        "BidReceived",
        "PlannerEngaged",
        "WorkQueued",
    ),
    # what the agents of one robot tell each other
    "message": ("InternalHandoff", "RoutineReported"),
    # commands from outside that were rejected
    "command": ("CommandRejected",),
    # what happens to robots: obstructions, wear, outages, encounters, injected attempts
    "world": (
        *(
            "SyncPhaseSet",
            "SnapshotPhaseSet",
            "ContextChanged",
            "ObstructionAppeared",
            "ObstructionCleared",
            "ActuatorDegraded",
        ),
        *(
            "RoutineDue",
            "PeersMet",
            "OutsiderRequestInjected",
            "RobotWentOff",
            "RobotCameBack",
            "LinkWentDown",
            "LinkCameUp",
        ),
    ),
}
"""The event types of each concern. `RunStarted` and `ExperimentPlanned` say what a run is; they are of no concern."""

CONCERNS: tuple[str, ...] = tuple(EVENTS_OF)
"""Every concern, in the order in which they are written. Runs of our own handlers observe all of them."""
