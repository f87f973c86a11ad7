-- What an agent with partial pooling has learned about the effects of messages for each person, at the updates of a trial.

DROP TRIGGER run_ends_without_results;

CREATE TABLE recorded_person (
    run INTEGER NOT NULL REFERENCES run (id),
    number INTEGER NOT NULL CHECK (number > 0),                 -- of the update, from 1
    person INTEGER NOT NULL CHECK (person >= 0),                -- from 1; 0 for what people have in common
    action INTEGER NOT NULL CHECK (action BETWEEN 1 AND 255),   -- the message
    step INTEGER NOT NULL CHECK (step >= 0),                    -- steps of the trial before the update
    mean TEXT NOT NULL CHECK (json_type(mean) = 'array'),       -- of the coefficients
    covariance TEXT NOT NULL CHECK (json_type(covariance) = 'array'),   -- its rows, one behind the other
    deviation TEXT NOT NULL CHECK (json_type(deviation) = 'array'),     -- of people around person 0; empty for the others
    PRIMARY KEY (run, number, person, action)
) STRICT, WITHOUT ROWID;

CREATE TRIGGER recorded_person_is_written_in_the_run BEFORE INSERT ON recorded_person
WHEN (SELECT status FROM run WHERE id = NEW.run) IS NOT 'running'
BEGIN SELECT RAISE(ABORT, 'results belong to a run in progress'); END;

CREATE TRIGGER recorded_person_is_fixed BEFORE UPDATE ON recorded_person
BEGIN SELECT RAISE(ABORT, 'results never change'); END;

CREATE TRIGGER recorded_person_stays BEFORE DELETE ON recorded_person
BEGIN SELECT RAISE(ABORT, 'results are never deleted'); END;

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
    OR EXISTS (SELECT 1 FROM action_total WHERE run = NEW.id)
    OR EXISTS (SELECT 1 FROM recorded_step WHERE run = NEW.id)
    OR EXISTS (SELECT 1 FROM recorded_description WHERE run = NEW.id)
    OR EXISTS (SELECT 1 FROM recorded_ending
        WHERE id BETWEEN NEW.id << 39 AND (NEW.id << 39) + 549755813887)
    OR EXISTS (SELECT 1 FROM recorded_participant
        WHERE id BETWEEN NEW.id << 39 AND (NEW.id << 39) + 549755813887)
    OR EXISTS (SELECT 1 FROM recorded_posterior WHERE run = NEW.id)
    OR EXISTS (SELECT 1 FROM recorded_person WHERE run = NEW.id)
    OR EXISTS (SELECT 1 FROM trained_weights WHERE run = NEW.id))
BEGIN SELECT RAISE(ABORT, 'only a completed run has results'); END;

CREATE VIEW person_posterior AS
SELECT
    job.key AS job_key,
    recorded.number AS number,
    recorded.step AS step,
    recorded.person AS person,
    recorded.action AS action,
    recorded.mean AS mean,
    recorded.covariance AS covariance,
    recorded.deviation AS deviation
FROM job
JOIN run ON run.job = job.id AND run.status = 'completed'
JOIN recorded_person AS recorded ON recorded.run = run.id;
