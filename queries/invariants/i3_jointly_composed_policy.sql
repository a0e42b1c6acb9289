-- Title: I3 broken: an execution or motion starts although the composed policy known then denies it
-- Paper: sec:model:invariants (I3), eq:policy
-- Grain: one row per start under a known deny, or after a refusal (the robot's own, or one that names no robot) that no
--   later admission or approval lifted
-- Key: run_id, seq
-- Units: time_us microseconds of run time
-- NULL: action_id for a motion
-- Example: fsar-ledger query invariants/i3_jointly_composed_policy LEDGER
-- The known policy is composed of the executor's own, the fleet's rule as last told to it, and the policy that the last
-- request carried. Windows of which no message had arrived belong to the metric of policy violations.
SELECT
    run_id, seq, time_us, type, action_id,
    robot || CASE
        WHEN denied_seq IS NOT NULL THEN ' starts after the refusal at seq ' || denied_seq || ', which nothing lifted'
        ELSE ' starts although the outcome that it knows is deny'
    END AS found
FROM known_policy
WHERE outcome = 'deny' OR denied_seq IS NOT NULL
