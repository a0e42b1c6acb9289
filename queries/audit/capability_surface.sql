-- Title: The capability surface of a robot at a time: its offers and their terms, and who may discover or request them
-- Paper: eq:adv, eq:advertise, eq:delegable
-- Grain: one row per run, robot and capability that it advertised at that time
-- Key: run_id, robot, capability
-- Units: since_us microseconds of run time; at seconds, by default after the end of every run
-- NULL: successor unless a deprecation names one; visible_to is empty when every role may discover it, may_ask when no
--   other member has role and trust, and NULL when the run does not observe fleet and trust; availability when the run
--   does not record its changes
-- Example: fsar-ledger query audit/capability_surface LEDGER --param run=RUN --param robot=robot/C1 --param at=30
--   answers inspect.private_zone 1.0.0 ready: discoverable by role B, and robot/B1 may ask for it
-- Parameters: run: run = all, robot: robot = all, at: time = end
WITH surfaces AS (
    SELECT *
    FROM advertisements
    WHERE
        $run IN ('all', run_id) AND $robot IN ('all', robot)
        AND since_us <= $at_us::BIGINT AND (until_us IS NULL OR until_us > $at_us::BIGINT)
),

scopes (scope, breadth) AS (
    VALUES ('none', 0), ('capability', 1), ('task', 2), ('session', 3), ('persistent', 4)
),

trusted AS (
    -- Visible_Gamma: the role, the domain around the requester, and some trust, which a request needs in any case.
    SELECT
        surfaces.run_id, surfaces.robot, surfaces.capability, surfaces.trust_required,
        peers.robot AS peer,
        arg_max(trust.scope, trust.precedence) AS scope
    FROM surfaces
    INNER JOIN trust_parties AS trusting
        ON surfaces.run_id = trusting.run_id AND surfaces.robot = trusting.robot AND trusting.is_trusting
    INNER JOIN trust_parties AS trusted
        ON trusting.run_id = trusted.run_id AND trusting.seq = trusted.seq AND NOT trusted.is_trusting
    INNER JOIN trust_precedence AS trust
        ON
            trusting.run_id = trust.run_id AND trusting.seq = trust.seq AND trust.context IS NULL
            AND trust.time_us <= $at_us::BIGINT AND (trust.capability IS NULL OR surfaces.capability = trust.capability)
    INNER JOIN fleet_members AS peers
        ON trusted.run_id = peers.run_id AND trusted.robot = peers.robot AND peers.joined_us <= $at_us::BIGINT
    INNER JOIN fleet_members AS owners ON surfaces.run_id = owners.run_id AND surfaces.robot = owners.robot
    ANTI JOIN departed_robots AS gone
        ON
            peers.run_id = gone.run_id AND peers.robot = gone.robot
            AND $at_us::BIGINT BETWEEN gone.since_us AND coalesce(gone.until_us - 1, $at_us::BIGINT)
    WHERE
        surfaces.robot <> trusted.robot
        AND (len(surfaces.visible_to) = 0 OR list_contains(surfaces.visible_to, peers.role))
        AND (
            coalesce(surfaces.visibility, '') <> 'domain' OR coalesce(owners.domain, '') IN ('', peers.domain)
            OR starts_with(peers.domain, owners.domain || '/')
        )
    GROUP BY surfaces.run_id, surfaces.robot, surfaces.capability, surfaces.trust_required, peers.robot
),

admissible AS (
    -- Policy, or the other terms of a request (version, contract, context), may still rule them out.
    SELECT
        trusted.run_id, trusted.robot, trusted.capability,
        list(trusted.peer ORDER BY trusted.peer) AS may_ask
    FROM trusted
    INNER JOIN scopes AS given ON trusted.scope = given.scope
    INNER JOIN scopes AS required ON trusted.trust_required = required.scope
    WHERE given.breadth > 0 AND given.breadth >= required.breadth
    GROUP BY trusted.run_id, trusted.robot, trusted.capability
)

SELECT
    surfaces.run_id, surfaces.robot, surfaces.capability, surfaces.since_us, surfaces.version, surfaces.preconditions,
    surfaces.postconditions, surfaces.resources, surfaces.trust_required, surfaces.policy_required,
    surfaces.override_allowed, surfaces.availability, surfaces.embodiment, surfaces.visibility, surfaces.visible_to,
    surfaces.is_deprecated, surfaces.successor,
    if(list_has_all(runs.observes, ['fleet', 'trust']), coalesce(admissible.may_ask, []), NULL) AS may_ask
FROM surfaces
INNER JOIN runs ON surfaces.run_id = runs.run_id
LEFT JOIN admissible
    ON
        surfaces.run_id = admissible.run_id AND surfaces.robot = admissible.robot
        AND surfaces.capability = admissible.capability
