-- Title: Capabilities that robots advertise: the terms and the periods
-- Paper: eq:adv, sec:architecture:registry
-- Grain: one row per run, robot, capability and period without a change of its advertisement; no row while it is not
--   advertised
-- Key: run_id, robot, capability, since_seq
-- Units: since_us, until_us microseconds of run time, half-open; since_seq the event that began the period
-- NULL: until_us and until_seq for an advertisement that stands to the end of the run; successor unless a deprecation
--   names one; availability when the run does not record its changes
-- Example: fsar-ledger query facts/advertisements LEDGER
WITH offered AS (
    SELECT DISTINCT run_id, robot, capability
    FROM capability_advertised
),

changes AS (
    -- A report of availability without a capability is about everything that the robot advertises.
    SELECT
        events.run_id, events.seq, events.time_us, events.type, events.availability, events.embodiment,
        events.override_allowed, events.policy_required, events.postconditions, events.preconditions, events.resources,
        events.robot, events.successor, events.trust_required, events.version, events.visibility, events.visible_to,
        offered.capability,
        list_has_any(list_cat(runs.observes, runs.records), ['registry', 'AvailabilityChanged']) AS tells_changes,
        events.type IN ('CapabilityAdvertised.v1', 'CapabilityWithdrawn.v1', 'CapabilityRemoved.v1') AS is_new,
        count_if(is_new)
            OVER (PARTITION BY offered.run_id, offered.robot, offered.capability ORDER BY events.seq)
            AS stand
    FROM offered
    INNER JOIN registry_events AS events
        ON
            offered.run_id = events.run_id AND offered.robot = events.robot
            AND (events.capability IS NULL OR offered.capability = events.capability)
    INNER JOIN run_started AS runs ON offered.run_id = runs.run_id
    WHERE is_new OR events.type IN ('AvailabilityChanged.v1', 'CapabilityDeprecated.v1')
),

terms AS (
    SELECT
        run_id, robot, capability,
        seq AS since_seq,
        time_us AS since_us,
        lead(seq) OVER later AS until_seq,
        lead(time_us) OVER later AS until_us,
        first_value(type) OVER terms AS began_by,
        first_value(version) OVER terms AS version,
        first_value(preconditions) OVER terms AS preconditions,
        first_value(postconditions) OVER terms AS postconditions,
        first_value(resources) OVER terms AS resources,
        first_value(coalesce(trust_required, 'capability')) OVER terms AS trust_required,
        first_value(policy_required) OVER terms AS policy_required,
        first_value(coalesce(override_allowed, 'none')) OVER terms AS override_allowed,
        last_value(if(tells_changes, if(is_new, coalesce(availability, 'ready'), availability), NULL) IGNORE NULLS)
            OVER terms
            AS availability,
        first_value(embodiment) OVER terms AS embodiment,
        first_value(coalesce(visibility, 'global')) OVER terms AS visibility,
        first_value(visible_to) OVER terms AS visible_to,
        coalesce(
            list_contains(list(CASE WHEN NOT is_new THEN version END) OVER terms, first_value(version) OVER terms),
            FALSE
        ) AS is_deprecated,
        last_value(successor IGNORE NULLS) OVER terms AS successor
    FROM changes
    WINDOW
        later AS (PARTITION BY run_id, robot, capability ORDER BY seq),
        terms AS (PARTITION BY run_id, robot, capability, stand ORDER BY seq)
)

SELECT * EXCLUDE (began_by)
FROM terms
WHERE began_by = 'CapabilityAdvertised.v1'
