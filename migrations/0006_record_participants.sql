-- The parameters of participants, where they differ: one row per parameter and episode in the view
-- participant.

CREATE TABLE recorded_participant (
    -- What names the parameter: run << 39 | (1 in the test) << 38 | episode << 14 | place of the parameter.
    -- No key allows more episodes. A value takes about 20 bytes.
    id INTEGER PRIMARY KEY CHECK (id > 0),
    value REAL NOT NULL CHECK (abs(value) <= 1.7976931348623157e308)
) STRICT;

CREATE TRIGGER recorded_participant_is_written_in_the_run BEFORE INSERT ON recorded_participant
WHEN (SELECT status FROM run WHERE id = NEW.id >> 39) IS NOT 'running'
BEGIN SELECT RAISE(ABORT, 'results belong to a run in progress'); END;

CREATE TRIGGER recorded_participant_is_fixed BEFORE UPDATE ON recorded_participant
BEGIN SELECT RAISE(ABORT, 'results never change'); END;

CREATE TRIGGER recorded_participant_stays BEFORE DELETE ON recorded_participant
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
    OR EXISTS (SELECT 1 FROM recorded_participant
        WHERE id BETWEEN NEW.id << 39 AND (NEW.id << 39) + 549755813887)
    OR EXISTS (SELECT 1 FROM trained_weights WHERE run = NEW.id))
BEGIN SELECT RAISE(ABORT, 'only a completed run has results'); END;

CREATE VIEW participant AS
SELECT
    job.key AS job_key,
    CASE recorded.id >> 38 & 1 WHEN 0 THEN 'train' ELSE 'test' END AS phase,
    recorded.id >> 14 & 16777215 AS episode,
    -- The places of the parameters never change.
    CASE recorded.id & 16383
        WHEN 0 THEN 'sigma'
        WHEN 1 THEN 'delta_h'
        WHEN 2 THEN 'epsilon_h'
        WHEN 3 THEN 'delta_d'
        WHEN 4 THEN 'epsilon_d'
        WHEN 5 THEN 'rho_1'
        WHEN 6 THEN 'rho_2'
        WHEN 7 THEN 'rho_3'
        WHEN 8 THEN 'mu'
        WHEN 9 THEN 'mu_0'
        WHEN 10 THEN 'mu_1'
        WHEN 11 THEN 'initial_habituation'
        WHEN 12 THEN 'initial_disengagement'
        WHEN 13 THEN 'disengagement_threshold'
        WHEN 14 THEN 'state_spread'
        WHEN 15 THEN 'kappa_h'
        WHEN 16 THEN 'kappa_d'
        WHEN 17 THEN 'sigma_s'
        WHEN 18 THEN 'parameter_spread'
        WHEN 19 THEN 'context_probability'
        WHEN 20 THEN 'context_persistence'
        WHEN 21 THEN 'availability'
        WHEN 22 THEN 'message_cost'
    END AS name,
    recorded.value AS value
FROM job
JOIN run ON run.job = job.id AND run.status = 'completed'
JOIN recorded_participant AS recorded
    ON recorded.id BETWEEN run.id << 39 AND (run.id << 39) + 549755813887;
