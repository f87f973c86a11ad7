CREATE VIEW decision AS
WITH place(i) AS (VALUES (0), (1), (2), (3), (4), (5), (6), (7), (8), (9)), packed AS (
    SELECT
        job.key AS job_key,
        CASE recorded.id >> 38 & 1 WHEN 0 THEN 'train' ELSE 'test' END AS phase,
        recorded.id >> 14 & 16777215 AS episode,
        (recorded.id & 16383) + i AS step,
        recorded.bits >> (5 * i) & 1 AS context,
        CASE i WHEN 0 THEN probability_0 WHEN 1 THEN probability_1 WHEN 2 THEN probability_2
            WHEN 3 THEN probability_3 WHEN 4 THEN probability_4 WHEN 5 THEN probability_5
            WHEN 6 THEN probability_6 WHEN 7 THEN probability_7 WHEN 8 THEN probability_8
            ELSE probability_9 END AS probability,
        recorded.bits >> (5 * i + 1) & 1 AS likely_context,
        CASE i WHEN 0 THEN habituation_0 WHEN 1 THEN habituation_1 WHEN 2 THEN habituation_2
            WHEN 3 THEN habituation_3 WHEN 4 THEN habituation_4 WHEN 5 THEN habituation_5
            WHEN 6 THEN habituation_6 WHEN 7 THEN habituation_7 WHEN 8 THEN habituation_8
            ELSE habituation_9 END AS habituation,
        CASE i WHEN 0 THEN disengagement_0 WHEN 1 THEN disengagement_1 WHEN 2 THEN disengagement_2
            WHEN 3 THEN disengagement_3 WHEN 4 THEN disengagement_4 WHEN 5 THEN disengagement_5
            WHEN 6 THEN disengagement_6 WHEN 7 THEN disengagement_7 WHEN 8 THEN disengagement_8
            ELSE disengagement_9 END AS disengagement,
        recorded.bits >> (5 * i + 2) & 1 AS available,
        recorded.bits >> (5 * i + 3) & 3 AS action,
        CASE i WHEN 0 THEN action_probability_0 WHEN 1 THEN action_probability_1
            WHEN 2 THEN action_probability_2 WHEN 3 THEN action_probability_3
            WHEN 4 THEN action_probability_4 WHEN 5 THEN action_probability_5
            WHEN 6 THEN action_probability_6 WHEN 7 THEN action_probability_7
            WHEN 8 THEN action_probability_8 ELSE action_probability_9 END AS action_probability,
        CASE i WHEN 0 THEN reward_0 WHEN 1 THEN reward_1 WHEN 2 THEN reward_2 WHEN 3 THEN reward_3
            WHEN 4 THEN reward_4 WHEN 5 THEN reward_5 WHEN 6 THEN reward_6 WHEN 7 THEN reward_7
            WHEN 8 THEN reward_8 ELSE reward_9 END AS reward,
        choice.bits >> (3 * i + 2) & 1 AS can_send,
        choice.bits >> (3 * i) & 3 AS chosen_action,
        json_extract(choice.probabilities, '$[' || i || ']') AS action_probabilities,
        CASE recorded.id >> 38 & 1 WHEN 1 THEN tested.length ELSE ended.length END AS length,
        CASE recorded.id >> 38 & 1 WHEN 1 THEN iif(tested.disengaged, 1, 2) ELSE ended.ending END AS ending
    FROM job
    JOIN run ON run.job = job.id AND run.status = 'completed'
    JOIN recorded_decision AS recorded
        ON recorded.id BETWEEN run.id << 39 AND (run.id << 39) + 549755813887
    LEFT JOIN recorded_choice AS choice ON choice.id = recorded.id
    LEFT JOIN test_episode AS tested
        ON (tested.run, tested.episode) = (run.id, recorded.id >> 14 & 16777215) AND recorded.id >> 38 & 1
    LEFT JOIN recorded_ending AS ended ON ended.id = recorded.id & ~16383
    CROSS JOIN place
    WHERE i < recorded.steps
)
SELECT job_key, phase, episode, step, context, probability, likely_context, habituation, disengagement, available,
    action, action_probability, reward, can_send, chosen_action, action_probabilities,
    json_object('context', context, 'probability', probability, 'likely_context', likely_context,
    'habituation', habituation, 'disengagement', disengagement) AS state,
    step + 1 = length AND ending = 1 AS terminated, step + 1 = length AND ending = 2 AS truncated
FROM packed
UNION ALL
SELECT
    job.key, CASE recorded.phase WHEN 0 THEN 'train' ELSE 'test' END, recorded.episode, recorded.step,
    CAST(json_extract(recorded.state, '$.context') AS INTEGER),
    json_extract(recorded.state, '$.probability'),
    CAST(json_extract(recorded.state, '$.likely_context') AS INTEGER),
    json_extract(recorded.state, '$.habituation'),
    json_extract(recorded.state, '$.disengagement'), recorded.available, recorded.action, recorded.action_probability,
    recorded.reward, recorded.can_send, recorded.chosen_action, recorded.action_probabilities, recorded.state,
    CASE recorded.phase WHEN 1 THEN recorded.step + 1 = tested.length AND tested.disengaged
        ELSE recorded.step + 1 = ended.length AND ended.ending = 1 END,
    CASE recorded.phase WHEN 1 THEN recorded.step + 1 = tested.length AND NOT tested.disengaged
        ELSE recorded.step + 1 = ended.length AND ended.ending = 2 END
FROM job
JOIN run ON run.job = job.id AND run.status = 'completed'
JOIN recorded_step AS recorded ON recorded.run = run.id
LEFT JOIN test_episode AS tested
    ON (tested.run, tested.episode) = (run.id, recorded.episode) AND recorded.phase = 1
LEFT JOIN recorded_ending AS ended
    ON ended.id = (run.id << 39) + (recorded.episode << 14) AND recorded.phase = 0;
