"""What a run may observe: the concerns, one word each, in the order in which they are written."""

CONCERNS: tuple[str, ...] = (
    "fleet",  # robots and their membership
    "registry",  # capabilities, advertisements, availability, look-ups
    "trust",  # trust scopes
    "policy",  # rules and windows of policy, own and the fleet's
    "task",  # tasks and their steps
    "request",  # requests between robots, from the gap to the end, and how they are decided
    "authority",  # claims, grants, revocations
    "execution",  # who does what, and routine
    "recovery",  # failures and what is done about them
    "supervision",  # supervisors: calls, answers, absences
    "knowledge",  # what a decider has been told, messages between the agents of one robot included
    "command",  # commands from outside that were rejected
    "world",  # what happens to robots: obstructions, wear, encounters, injected attempts
)
"""Every concern. Runs of our own handlers observe all of them."""
