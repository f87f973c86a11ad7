-- What agents chose and with which probabilities: more columns of the view decision.

CREATE TABLE recorded_choice (
    -- The row of recorded_decision with the same steps. Rows from before this version have none.
    id INTEGER PRIMARY KEY CHECK (id > 0),
    -- Three bits per step, the first step lowest: chosen action | can send << 2.
    bits INTEGER NOT NULL CHECK (bits >= 0 AND bits >> 30 = 0),
    -- A JSON array with one element per step: an array of the probabilities of all actions, or null where only
    -- the probability of the chosen action is known.
    probabilities TEXT NOT NULL CHECK (json_type(probabilities) = 'array')
) STRICT;

CREATE TRIGGER recorded_choice_is_written_in_the_run BEFORE INSERT ON recorded_choice
WHEN (SELECT status FROM run WHERE id = NEW.id >> 39) IS NOT 'running'
BEGIN SELECT RAISE(ABORT, 'results belong to a run in progress'); END;

CREATE TRIGGER recorded_choice_is_fixed BEFORE UPDATE ON recorded_choice
BEGIN SELECT RAISE(ABORT, 'results never change'); END;

CREATE TRIGGER recorded_choice_stays BEFORE DELETE ON recorded_choice
BEGIN SELECT RAISE(ABORT, 'results are never deleted'); END;

DROP TRIGGER run_ends_without_results;

CREATE TRIGGER run_ends_without_results BEFORE UPDATE OF status ON run
WHEN NEW.status IN ('failed', 'interrupted') AND (
    EXISTS (SELECT 1 FROM run_metric WHERE run = NEW.id)
    OR EXISTS (SELECT 1 FROM curve_point WHERE run = NEW.id)
    OR EXISTS (SELECT 1 FROM test_episode WHERE run = NEW.id)
    OR EXISTS (SELECT 1 FROM action_count WHERE run = NEW.id)
    OR EXISTS (SELECT 1 FROM recorded_decision
        WHERE id BETWEEN NEW.id << 39 AND (NEW.id << 39) + 549755813887)
    OR EXISTS (SELECT 1 FROM recorded_choice
        WHERE id BETWEEN NEW.id << 39 AND (NEW.id << 39) + 549755813887)
    OR EXISTS (SELECT 1 FROM recorded_participant
        WHERE id BETWEEN NEW.id << 39 AND (NEW.id << 39) + 549755813887)
    OR EXISTS (SELECT 1 FROM trained_weights WHERE run = NEW.id))
BEGIN SELECT RAISE(ABORT, 'only a completed run has results'); END;

DROP VIEW decision;

CREATE VIEW decision AS
WITH place(i) AS (VALUES (0), (1), (2), (3), (4), (5), (6), (7), (8), (9))
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
    json_extract(choice.probabilities, '$[' || i || ']') AS action_probabilities
FROM job
JOIN run ON run.job = job.id AND run.status = 'completed'
JOIN recorded_decision AS recorded
    ON recorded.id BETWEEN run.id << 39 AND (run.id << 39) + 549755813887
LEFT JOIN recorded_choice AS choice ON choice.id = recorded.id
CROSS JOIN place
WHERE i < recorded.steps;
