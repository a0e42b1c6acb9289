-- Title: Messages and deeds: who told whom what, with the recorded details
-- Paper: sec:model:request, fig:wf1
-- Grain: one row per event in the timeline of an action, two for a registry's answer (part 1 and 2)
-- Key: run_id, seq, part
-- Units: time_us microseconds of run time; part counts from 1
-- NULL: action_id, sender, receiver when the record does not name them; note when there is nothing to add. A robot's
--   own deed has the robot as both, whatever principal the record names. The caller of a supervisor, and the receiver
--   of the answer, are those of facts/supervision_ends
-- Example: fsar-ledger query facts/messages LEDGER
WITH told AS (
    SELECT
        events.run_id, events.seq, events.time_us, events.type, keyed_events.action_id,
        MAP {
            'decider': decided_by, 'requester': requested_by, 'executor': executed_by, 'supervisor': supervised_by,
            'robot': robot, 'peer': peer, 'claimant': claimant, 'sender': sender, 'receiver': receiver,
            'called': supervisor, 'helper': coalesce(helper, decided_by), 'caller': ends.caller, 'asker': ends.asker,
            'registry': if(
                regexp_matches(runs.configuration, '^without-(.*[+])?shared-registry([+]|$)'), requested_by,
                'service/registry'
            ),
            'target': if(events.action_id IS NULL AND request_id IS NULL, decided_by, coalesce(relay, executed_by)),
            'doer': coalesce(executed_by, if(regexp_matches(decided_by, '^(robot|agent)/'), decided_by, NULL))
        } AS parties,
        MAP {
            'capability': capability, 'cause': cause, 'purpose': purpose, 'reason': reason,
            'result': result || if(events.type = 'RequestClosed.v1', coalesce('(' || cause || ')', ''), ''),
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
    LEFT JOIN supervision_ends AS ends ON events.run_id = ends.run_id AND events.seq = ends.seq
    WHERE
        events.type IN (SELECT message_words.type FROM message_words)
        AND (events.type <> 'AuthorityClaimed.v1' OR reason = 'revocation')
)

SELECT
    told.run_id, told.seq, words.part, told.time_us, told.type, told.action_id,
    told.parties[words.sender] AS sender,
    told.parties[words.receiver] AS receiver,
    words.words || coalesce(': ' || told.details[words.detail], '') AS message,
    nullif(concat_ws(
        '; ',
        if(told.type <> 'RegistryQueried.v1' OR part = 2, told.note, NULL),
        denied.note, 'under ' || called.told
    ), '') AS note
FROM told
INNER JOIN message_words AS words ON told.type = words.type
LEFT JOIN denied_actions AS denied ON told.run_id = denied.run_id AND told.seq = denied.seq
LEFT JOIN named_grounds AS called
    ON told.type = 'SupervisorCalled.v1' AND told.run_id = called.run_id AND told.seq = called.seq
