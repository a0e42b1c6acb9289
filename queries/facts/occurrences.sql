-- Title: Events that are in no timeline of a request: acts of one robot, what happens to it, and rules set
-- Paper: sec:model, sec:evaluation:simulator
-- Grain: one row per event of a type of facts/occurrence_words; claims of authority only if they revoke nothing
-- Key: run_id, seq
-- Units: time_us microseconds of run time
-- NULL: action_id when the record names none; sender, receiver when the record does not name them; note when there is
--   nothing to add. A robot's own deed, and anything that happens to it, has the same sender and receiver
-- Example: fsar-ledger query facts/occurrences LEDGER
WITH gave AS (
    SELECT run_id, seq, issued_by AS given_by FROM command_given
),

told AS (
    SELECT
        events.run_id, events.seq, events.time_us, events.type, events.action_id, words.words,
        MAP {
            'robot': robot, 'peer': peer, 'requester': requested_by, 'decider': decided_by, 'claimant': claimant,
            'issuer': coalesce(given_by, issued_by), 'holder': holder, 'on_shift': supervisor, 'task': task_id,
            'robots': coalesce(robot, 'every robot'), 'role': 'role ' || role, 'peer_role': 'role ' || peer_role,
            'registry': 'service/registry', 'coordinator': 'coordinator', 'run': 'run', 'experiment': 'experiment',
            'federation': 'federation', 'source': source
        } AS parties,
        words.sender, words.receiver, words.detail,
        MAP {
            'begins': coalesce(nullif(concat_ws(' ', architecture, configuration, scenario), ''), source),
            'format': format, 'kind': kind, 'from': coalesce(continues, fleet_run, isolated_run), 'result': result,
            'planned': run_count || ' runs of each architecture, configuration and scenario',
            'role': role, 'capability': capability, 'availability': availability, 'scope': scope, 'window': "window",
            'thresholds': if(promote_after = 0, 'never promoted', 'promoted after ' || promote_after)
            || if(downgrade_after = 0, ', never downgraded', ', downgraded after ' || downgrade_after),
            'rule': scope || ' ' || outcome, 'phase': phase_ppm || ' ppm', 'obstruction': obstruction, 'grade': grade,
            'peer': peer, 'task': task_id, 'dimension': dimension, 'granted': 'override ' || override,
            'reason': reason, 'operation': operation, 'outcome': outcome, 'item': item, 'command': command,
            'density': if(review_every = 0, 'no reviews', 'a review every ' || review_every || ' admissions'),
            'budget': concat(level, ', ', n_max, ' attempt', if(n_max = 1, '', 's'), ' within ', t_max_us / 1e6, ' s')
        } AS details,
        concat_ws(
            '; ',
            CASE WHEN events.type = 'RobotJoined.v1' THEN 'team ' || team END,
            CASE WHEN events.type = 'RobotJoined.v1' THEN 'supervisor ' || supervisor END,
            'fencing number ' || fence, 'key ' || public_key,
            'in ' || nullif(domain, ''), 'at ' || place, 'version ' || version, 'successor ' || successor,
            CASE WHEN words.detail IS DISTINCT FROM 'capability' THEN capability END, 'in context ' || context,
            CASE WHEN words.detail = 'window' THEN concat_ws(' ', scope, outcome) END,
            CASE WHEN events.type = 'ContextChanged.v1' THEN 'window ' || "window" END,
            'visible ' || visibility, CASE WHEN words.detail IS DISTINCT FROM 'availability' THEN availability END,
            CASE
                WHEN candidates IS NOT NULL
                    THEN 'candidates: ' || coalesce(nullif(array_to_string(candidates, ', '), ''), 'none')
            END,
            'left out: ' || nullif(array_to_string(
                list_transform(list_zip(rejected, rejected_by), LAMBDA pair: pair[1] || ' by ' || pair[2]), ', '
            ), ''),
            'about ' || nullif(array_to_string(objects, ', '), ''),
            nullif(array_to_string(
                list_transform(list_zip(names, texts), LAMBDA pair: pair[1] || ' ' || pair[2]), ', '
            ), ''),
            CASE WHEN len(steps) > 0 THEN len(steps) || if(len(steps) = 1, ' step', ' steps') END,
            'budget ' || (budget_us / 1000000) || ' s', 'due ' || (due_us / 1000000) || ' s',
            'step ' || step, 'attempt ' || attempt, 'with a robot of role ' || target_role,
            CASE WHEN robot <> on_behalf_of THEN 'for ' || on_behalf_of END, 'done at ' || ready_us / 1000000 || ' s',
            'as of ' || (as_of_us / 1000000) || ' s', 'until ' || (until_us / 1000000) || ' s',
            'about ' || subject, CASE WHEN words.detail IS DISTINCT FROM 'reason' THEN reason END,
            CASE WHEN words.sender <> 'decider' THEN 'decided by ' || nullif(decided_by, coalesce(robot, '')) END
        ) AS note
    FROM events
    INNER JOIN occurrence_words AS words ON events.type = words.type
    -- Work for a robot is in its name even if another principal gives it.
    LEFT JOIN gave
        ON events.run_id = gave.run_id AND events.caused_by = gave.seq AND events.type = 'CommandRejected.v1'
    WHERE events.type <> 'AuthorityClaimed.v1' OR reason <> 'revocation'
)

SELECT
    run_id, seq, time_us, type, action_id,
    parties[sender] AS sender,
    parties[receiver] AS receiver,
    words || coalesce(': ' || details[detail], '') AS message,
    nullif(note, '') AS note
FROM told
