"""The request lifecycle and its counterparts in the two baselines (Delta, `eq:request`)."""

from .envelope import (
    ActionId,
    Agent,
    Event,
    FailureCause,
    OverrideLevel,
    Parties,
    PolicyOutcome,
    Principals,
    RequestId,
    RequestSubject,
    Result,
    Robot,
    Subject,
    TaskId,
    TrustScope,
)


class GapDetected(Event, frozen=True):
    """A step needs a capability that the acting robot lacks. Paper: sec:model:request, phase 1."""

    subject: Subject[TaskId | None, ActionId | None]
    principals: Parties
    capability: str


class RequestIssued(Event, frozen=True, kw_only=True):
    """A request was sent. `carried_policy` is the requester's own policy at this moment, if the request carries it.

    `override` is the level it asks for; `parent` the request on whose behalf it is made (a chain); `directives` what it
    tries to dictate to the executor (`plan`, `policy`, `recovery`), which no request may do; `version` the version
    advertised when it was written, if it depends on that. Paper: eq:request, phase 3; eq:override; eq:nontransitive.
    """

    subject: RequestSubject[TaskId | None, ActionId | None, RequestId | None]
    principals: Principals
    capability: str
    carried_policy: PolicyOutcome | None = None
    relay: Robot | None = None
    override: OverrideLevel = "none"
    parent: ActionId | None = None
    directives: tuple[str, ...] = ()
    version: str | None = None


class RequestRelayed(Event, frozen=True):
    """A doubly trusted peer has passed the request on, composing its own policy. Paper: eq:nontransitive."""

    subject: RequestSubject[TaskId, ActionId, RequestId]
    principals: Principals
    carried_policy: PolicyOutcome


class RequestUnanswered(Event, frozen=True):
    """No candidate is known for the step, or the one that was asked has not answered in time.

    `executed_by` is the robot that was asked. The step is tried again.
    """

    subject: Subject[TaskId, ActionId]
    principals: Principals
    capability: str


class PeerSought(Event, frozen=True):
    """The robot has looked again among the peers it has met, and found none."""

    subject: Subject[TaskId, ActionId]
    robot: Robot


class CandidateMatched(Event, frozen=True):
    """The coordinator has considered one candidate for a step. Paper: sec:evaluation:baselines (CFC)."""

    task_id: TaskId
    principals: Principals
    capability: str


class BidSubmitted(Event, frozen=True):
    """A robot has sent a bid: a proposal, or (`deny`) a refusal. Paper: sec:evaluation:baselines (DHMA).

    `ahead` is the number of actions that the robot will do first, if the proposal says so.
    """

    task_id: TaskId
    principals: Parties
    robot: Robot
    outcome: PolicyOutcome
    ahead: int | None = None


class AwardMade(Event, frozen=True):
    """The requester has awarded the contract. Paper: sec:evaluation:baselines (DHMA).

    `rejected` are the other robots that proposed, if they are told.
    """

    task_id: TaskId
    principals: Parties
    robot: Robot
    rejected: tuple[Robot, ...] | None = None


class MessageUndelivered(Event, frozen=True):
    """The platform has found that a message about the action cannot be delivered to this robot.

    JADE: the sender gets a FAILURE from the AMS (jade/core/messaging/MessagingService.java).
    """

    subject: Subject[TaskId, ActionId]
    robot: Robot


class SegmentTransferred(Event, frozen=True):
    """The next segment of the task, from this step on, has been given to the robot that acts in it.

    A segment ends where another robot acts; its end is given back in the same way. Paper: sec:evaluation:scenarios
    (Scenario 2: task segment transfer).
    """

    task_id: TaskId
    principals: Principals
    robot: Robot
    step: int


class InternalHandoff(Event, frozen=True):
    """One agent of a robot has passed work to another; nothing ties the message to a request.

    Paper: sec:evaluation:baselines (DHMA).
    """

    principals: Parties
    sender: Agent
    receiver: Agent


class RequestAdmitted(Event, frozen=True, kw_only=True):
    """The executor has found the request admissible. Paper: eq:admissible, phase 4.

    The fields are the trust on which the admission rests and the authority tuple that it grants: may request, may
    execute, override level, audited (None where the architecture evaluates neither). Paper: eq:auth.
    """

    subject: RequestSubject[TaskId | None, ActionId | None, RequestId | None]
    principals: Principals
    outcome: PolicyOutcome
    trust: TrustScope | None = None
    may_request: bool | None = None
    may_execute: bool | None = None
    override: OverrideLevel | None = None
    is_audited: bool | None = None


class RequestDenied(Event, frozen=True):
    """The request may not go ahead now. Paper: sec:model:request (reject), eq:admissible.

    `reason` is the conjunct that failed: possession, advertisement, trust, policy, local-execution, authority,
    negotiation or review.
    """

    subject: RequestSubject[TaskId | None, ActionId | None, RequestId | None]
    principals: Principals
    reason: str


class RequestDeferred(Event, frozen=True):
    """The request must wait its turn. Paper: sec:model:request (defer)."""

    subject: RequestSubject[TaskId, ActionId, RequestId | None]
    principals: Principals


class RequestCountered(Event, frozen=True):
    """The executor offers other terms: at most this override level. Paper: sec:model:request (negotiate).

    `round` counts the offers of the request from 1; the number of rounds is bounded.
    """

    subject: RequestSubject[TaskId | None, ActionId | None, RequestId | None]
    principals: Principals
    round: int
    override: OverrideLevel


class OfferAnswered(Event, frozen=True):
    """The requester has answered the counter-offer.

    It accepts the terms, asks for others, or (neither) gives up. Paper: sec:model:request (negotiate).
    """

    subject: RequestSubject[TaskId | None, ActionId | None, RequestId | None]
    principals: Principals
    round: int
    is_accepted: bool
    override: OverrideLevel | None = None


class CommandIssued(Event, frozen=True):
    """The coordinator has delegated a step to a robot; `seen_busy` is what its copy showed.

    Paper: sec:evaluation:baselines (CFC).
    """

    subject: RequestSubject[TaskId, ActionId, RequestId | None]
    principals: Principals
    robot: Robot
    seen_busy: bool | None


class RequestAccepted(Event, frozen=True):
    """The executor is committed to the request. Paper: sec:model:request (accept)."""

    subject: RequestSubject[TaskId, ActionId, RequestId | None]
    principals: Principals


class ContractQuestioned(Event, frozen=True):
    """A party's context changed after the award, so the contract may no longer hold.

    Paper: sec:evaluation:baselines (DHMA).
    """

    subject: Subject[TaskId, ActionId]
    robot: Robot


class ContractVoided(Event, frozen=True):
    """The contract is void and is renegotiated under the same action. Paper: sec:evaluation:baselines (DHMA)."""

    subject: Subject[TaskId, ActionId]
    robot: Robot


class RequestClosed(Event, frozen=True):
    """Completion has been tracked and the request is closed. Paper: sec:architecture:fleet (coordination engine).

    `cause` is `departed` where one of its robots has left the fleet. Paper: sec:discussion:heterogeneity.
    """

    subject: RequestSubject[TaskId, ActionId, RequestId | None]
    principals: Principals
    result: Result = "success"
    cause: FailureCause | None = None
