-- Title: Messages and deeds: who told whom what, with the recorded details
-- Paper: sec:model:request, fig:wf1
-- Grain: one row per event in the timeline of an action, two for a registry's answer (part 1 and 2)
-- Key: run_id, seq, part
-- Units: time_us microseconds of run time; part counts from 1
-- NULL: action_id, sender, receiver when the record does not say; note when there is nothing to add. A robot's own
--   deed has the robot as both, whatever principal the record names. Who calls a supervisor is not recorded: for a
--   review that names a robot it is the coordinator, for one about a bid the requester, for recovery the decider that
--   was named last, else the executor named last or the robot whose step it is. The answer goes to the executor that
--   it names, or to who called; the supervisor has it as a deed when neither is on record
-- Example: fsar-ledger query facts/messages LEDGER
WITH calls AS (
    SELECT
        run_id, seq,
        reason AS is_about,
        robot AS is_of
    FROM policies_seen
),

told AS (
    SELECT
        events.run_id, events.seq, events.time_us, events.type, keyed_events.action_id,
        MAP {
            'decider': decided_by, 'requester': requested_by, 'executor': executed_by, 'supervisor': supervised_by,
            'robot': robot, 'peer': peer, 'claimant': claimant, 'sender': sender, 'receiver': receiver,
            'called': supervisor, 'helper': coalesce(helper, decided_by),
            'registry': if(
                regexp_matches(runs.configuration, '^without-(.*[+])?shared-registry([+]|$)'), requested_by,
                'service/registry'
            ),
            'target': if(events.action_id IS NULL AND request_id IS NULL, decided_by, coalesce(relay, executed_by)),
            'caller': CASE
                WHEN purpose = 'review' AND robot IS NOT NULL THEN 'coordinator'
                WHEN purpose = 'recovery' THEN last_value(decided_by IGNORE NULLS) OVER earlier
                WHEN calls.is_about = 'bid' THEN last_value(requested_by IGNORE NULLS) OVER earlier
                ELSE coalesce(last_value(executed_by IGNORE NULLS) OVER earlier, calls.is_of)
            END
        } AS parties,
        MAP {
            'capability': capability, 'cause': cause, 'result': result, 'purpose': purpose, 'reason': reason,
            'candidates': coalesce(nullif(array_to_string(candidates, ', '), ''), 'none'),
            'outcome': outcome, 'policy': 'policy ' || outcome, 'override': override, 'number': events.number::VARCHAR,
            'answer': if(is_accepted, 'accepted', coalesce('asks ' || override, 'let go')),
            'level': level, 'levels': level || ' to ' || to_level,
            'checkpoint': if(helper IS NULL, 'not feasible', coalesce(checkpoint, 'from the last step boundary')),
            'decision': CASE
                WHEN preferred IS NOT NULL THEN preferred || ' first'
                WHEN NOT approves THEN 'refused'
                ELSE CASE purpose WHEN 'review' THEN 'approved' WHEN 'recovery' THEN 'resolved' ELSE 'ordered' END
            END
        } AS details,
        nullif(concat_ws(
            '; ',
            'carries policy ' || carried_policy, 'through ' || relay, 'trust ' || trust,
            if(may_request IS NULL, NULL, format(
                'authority ({}, {}, {}, {})',
                may_request::INT, may_execute::INT, coalesce(nullif(override, 'none'), '0'), is_audited::INT
            )),
            CASE WHEN events.type = 'RequestIssued.v1' THEN 'override ' || nullif(override, 'none') END,
            'in ' || nullif(domain, ''), 'as of ' || (as_of_us / 1000000) || ' s',
            'left out: ' || nullif(array_to_string(
                list_transform(list_zip(rejected, rejected_by), LAMBDA pair: pair[1] || ' by ' || pair[2]), ', '
            ), ''),
            CASE WHEN events.type NOT IN ('RequestDenied.v1', 'AuthorityClaimed.v1') THEN reason END,
            'gives way to ' || preempted_by, keyed_events.action_id || ' competes with ' || competing,
            CASE WHEN events.type = 'RecoveryAttempted.v1' THEN 'level ' || level END,
            'achieved ' || nullif(array_to_string(achieved, ', '), ''),
            CASE WHEN events.type = 'ExecutionStarted.v1' AND robot <> on_behalf_of THEN 'for ' || on_behalf_of END,
            CASE WHEN events.type = 'ExecutionStarted.v1' AND executed_by IS NULL THEN 'no executor on record' END
        ), '') AS note
    FROM events
    INNER JOIN keyed_events ON events.run_id = keyed_events.run_id AND events.seq = keyed_events.seq
    INNER JOIN runs ON events.run_id = runs.run_id
    LEFT JOIN calls ON events.run_id = calls.run_id AND events.seq = calls.seq
    WHERE
        events.type IN (SELECT message_words.type FROM message_words)
        AND (events.type <> 'AuthorityClaimed.v1' OR reason = 'revocation')
    WINDOW earlier AS (
        PARTITION BY events.run_id, keyed_events.action_id ORDER BY events.seq
        ROWS BETWEEN UNBOUNDED PRECEDING AND 1 PRECEDING
    )
),

answered AS (
    SELECT
        run_id, seq,
        coalesce(
            parties['executor'],
            last_value(if(type = 'SupervisorCalled.v1', parties['caller'], NULL) IGNORE NULLS) OVER (
                PARTITION BY run_id, action_id, details['purpose'] ORDER BY seq
            ),
            parties['requester'], parties['decider'], parties['supervisor']
        ) AS receiver
    FROM told
    WHERE type IN ('SupervisorCalled.v1', 'SupervisorResponded.v1')
)

SELECT
    told.run_id, told.seq, words.part, told.time_us, told.type, told.action_id,
    told.parties[words.sender] AS sender,
    if(words.receiver = 'asker', answered.receiver, told.parties[words.receiver]) AS receiver,
    words.words || coalesce(': ' || told.details[words.detail], '') AS message,
    nullif(concat_ws(
        '; ',
        if(told.type <> 'RegistryQueried.v1' OR part = 2, told.note, NULL),
        denied.note,
        'under ' || called.told
    ), '') AS note
FROM told
INNER JOIN message_words AS words ON told.type = words.type
LEFT JOIN answered ON told.run_id = answered.run_id AND told.seq = answered.seq
LEFT JOIN denied_actions AS denied ON told.run_id = denied.run_id AND told.seq = denied.seq
LEFT JOIN named_grounds AS called
    ON told.type = 'SupervisorCalled.v1' AND told.run_id = called.run_id AND told.seq = called.seq
