-- Decisions of jobs that ask for them: one row per step in the view decision.

CREATE TABLE recorded_decision (
    -- Up to ten steps of an episode. A row costs more time than a value, and the check below that the
    -- run is in progress is made per row. So a step takes about 50 bytes and half a microsecond.
    -- What names the first step: run << 39 | (1 in the test) << 38 | episode << 14 | step. No key allows
    -- more episodes or steps.
    id INTEGER PRIMARY KEY CHECK (id > 0),
    steps INTEGER NOT NULL CHECK (steps BETWEEN 1 AND 10),
    -- Five bits per step, the first step lowest: context | likely context << 1 | available << 2
    -- | action << 3.
    bits INTEGER NOT NULL CHECK (bits >= 0 AND bits >> (5 * steps) = 0),
    -- NULL behind the last step. The probability is that which the letter P shows.
    probability_0 REAL NOT NULL, habituation_0 REAL NOT NULL, disengagement_0 REAL NOT NULL, action_probability_0 REAL NOT NULL, reward_0 REAL NOT NULL,
    probability_1 REAL, habituation_1 REAL, disengagement_1 REAL, action_probability_1 REAL, reward_1 REAL,
    probability_2 REAL, habituation_2 REAL, disengagement_2 REAL, action_probability_2 REAL, reward_2 REAL,
    probability_3 REAL, habituation_3 REAL, disengagement_3 REAL, action_probability_3 REAL, reward_3 REAL,
    probability_4 REAL, habituation_4 REAL, disengagement_4 REAL, action_probability_4 REAL, reward_4 REAL,
    probability_5 REAL, habituation_5 REAL, disengagement_5 REAL, action_probability_5 REAL, reward_5 REAL,
    probability_6 REAL, habituation_6 REAL, disengagement_6 REAL, action_probability_6 REAL, reward_6 REAL,
    probability_7 REAL, habituation_7 REAL, disengagement_7 REAL, action_probability_7 REAL, reward_7 REAL,
    probability_8 REAL, habituation_8 REAL, disengagement_8 REAL, action_probability_8 REAL, reward_8 REAL,
    probability_9 REAL, habituation_9 REAL, disengagement_9 REAL, action_probability_9 REAL, reward_9 REAL
) STRICT;

CREATE TRIGGER recorded_decision_is_written_in_the_run BEFORE INSERT ON recorded_decision
WHEN (SELECT status FROM run WHERE id = NEW.id >> 39) IS NOT 'running'
BEGIN SELECT RAISE(ABORT, 'results belong to a run in progress'); END;

CREATE TRIGGER recorded_decision_is_fixed BEFORE UPDATE ON recorded_decision
BEGIN SELECT RAISE(ABORT, 'results never change'); END;

CREATE TRIGGER recorded_decision_stays BEFORE DELETE ON recorded_decision
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
    OR EXISTS (SELECT 1 FROM trained_weights WHERE run = NEW.id))
BEGIN SELECT RAISE(ABORT, 'only a completed run has results'); END;

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
        WHEN 8 THEN reward_8 ELSE reward_9 END AS reward
FROM job
JOIN run ON run.job = job.id AND run.status = 'completed'
JOIN recorded_decision AS recorded
    ON recorded.id BETWEEN run.id << 39 AND (run.id << 39) + 549755813887
CROSS JOIN place
WHERE i < recorded.steps;
