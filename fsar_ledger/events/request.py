"""The request lifecycle and its counterparts in the two baselines (Delta, `eq:request`)."""

from .envelope import Event, PolicyOutcome


class GapDetected(Event, frozen=True):
    """A step needs a capability that the acting robot lacks. Paper: sec:model:request, phase 1."""

    task_id: str | None
    action_id: str | None
    requested_by: str | None
    executed_by: str | None
    supervised_by: str | None
    capability: str


class RequestIssued(Event, frozen=True):
    """A request is on its way. `carried_policy` is the requester's own policy at this moment, if it sends it.

    Paper: eq:request, phase 3.
    """

    task_id: str | None
    action_id: str | None
    request_id: str | None
    decided_by: str | None
    requested_by: str | None
    executed_by: str | None
    supervised_by: str | None
    path: tuple[str, ...]
    capability: str
    carried_policy: PolicyOutcome | None = None
    relay: str | None = None


class RequestRelayed(Event, frozen=True):
    """A doubly trusted peer has passed the request on, composing its own policy. Paper: eq:nontransitive."""

    task_id: str
    action_id: str
    request_id: str
    decided_by: str | None
    requested_by: str | None
    executed_by: str | None
    supervised_by: str | None
    path: tuple[str, ...]
    carried_policy: PolicyOutcome


class RequestUnanswered(Event, frozen=True):
    """No candidate is known for the step; the robot goes on looking."""

    task_id: str
    action_id: str
    decided_by: str | None
    requested_by: str | None
    executed_by: str | None
    supervised_by: str | None
    path: tuple[str, ...]
    capability: str


class PeerSought(Event, frozen=True):
    """The robot has looked again among the peers it has met, and found none."""

    task_id: str
    action_id: str
    robot: str


class CandidateMatched(Event, frozen=True):
    """The coordinator has considered one candidate for a step. Paper: sec:evaluation:baselines (CFC)."""

    task_id: str
    decided_by: str | None
    requested_by: str | None
    executed_by: str | None
    supervised_by: str | None
    path: tuple[str, ...]
    capability: str


class BidSubmitted(Event, frozen=True):
    """A bid has left a robot's communication agent. Paper: sec:evaluation:baselines (DHMA)."""

    task_id: str
    requested_by: str | None
    executed_by: str | None
    supervised_by: str | None
    robot: str
    outcome: PolicyOutcome


class AwardMade(Event, frozen=True):
    """The requester's planner has awarded the contract. Paper: sec:evaluation:baselines (DHMA)."""

    task_id: str
    requested_by: str | None
    executed_by: str | None
    supervised_by: str | None
    robot: str


class InternalHandoff(Event, frozen=True):
    """One agent of a robot has passed work to another; nothing ties the message to a request. Paper: sec:evaluation:baselines (DHMA)."""

    requested_by: str | None
    executed_by: str | None
    supervised_by: str | None
    sender: str
    receiver: str


class RequestAdmitted(Event, frozen=True):
    """The executor has found the request admissible. Paper: eq:admissible, phase 4."""

    task_id: str | None
    action_id: str | None
    request_id: str | None
    decided_by: str | None
    requested_by: str | None
    executed_by: str | None
    supervised_by: str | None
    path: tuple[str, ...]
    outcome: PolicyOutcome


class RequestDenied(Event, frozen=True):
    """The request may not go ahead now, for the reason named. Paper: sec:model:request (reject)."""

    task_id: str | None
    action_id: str | None
    request_id: str | None
    decided_by: str | None
    requested_by: str | None
    executed_by: str | None
    supervised_by: str | None
    path: tuple[str, ...]
    reason: str


class RequestDeferred(Event, frozen=True):
    """The request must wait its turn. Paper: sec:model:request (defer)."""

    task_id: str
    action_id: str
    request_id: str | None
    decided_by: str | None
    requested_by: str | None
    executed_by: str | None
    supervised_by: str | None
    path: tuple[str, ...]


class CommandIssued(Event, frozen=True):
    """The coordinator has delegated a step to a robot; `seen_busy` is what its copy showed. Paper: sec:evaluation:baselines (CFC)."""

    task_id: str
    action_id: str
    request_id: str | None
    decided_by: str | None
    requested_by: str | None
    executed_by: str | None
    supervised_by: str | None
    path: tuple[str, ...]
    robot: str
    seen_busy: bool


class RequestAccepted(Event, frozen=True):
    """The executor is committed to the request. Paper: sec:model:request (accept)."""

    task_id: str
    action_id: str
    request_id: str | None
    decided_by: str | None
    requested_by: str | None
    executed_by: str | None
    supervised_by: str | None
    path: tuple[str, ...]


class ContractQuestioned(Event, frozen=True):
    """A party's context changed after the award, so the contract may no longer hold. Paper: sec:evaluation:baselines (DHMA)."""

    task_id: str
    action_id: str
    robot: str


class ContractVoided(Event, frozen=True):
    """The contract is off and must be negotiated again, under the same action. Paper: sec:evaluation:baselines (DHMA)."""

    task_id: str
    action_id: str
    robot: str


class RequestClosed(Event, frozen=True):
    """Completion has been tracked and the request is over. Paper: sec:architecture:fleet (coordination engine)."""

    task_id: str
    action_id: str
    request_id: str | None
    decided_by: str | None
    requested_by: str | None
    executed_by: str | None
    supervised_by: str | None
    path: tuple[str, ...]


RequestEvent = (
    GapDetected
    | RequestIssued
    | RequestRelayed
    | RequestUnanswered
    | PeerSought
    | CandidateMatched
    | BidSubmitted
    | AwardMade
    | InternalHandoff
    | RequestAdmitted
    | RequestDenied
    | RequestDeferred
    | CommandIssued
    | RequestAccepted
    | ContractQuestioned
    | ContractVoided
    | RequestClosed
)
