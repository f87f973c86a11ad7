-- Results in environments of any family: up to 256 actions, choices without strata, and recorded states of any
-- names, and the descriptions of outside programs. The family of a job is environment.family in its canonical form, absent for step_count.

DROP VIEW action_choice;
DROP TRIGGER run_ends_without_results;

CREATE TABLE action_total (
    -- Choices of action in an environment of another family than step_count, whose choices action_count counts by
    -- context.
    run INTEGER NOT NULL REFERENCES run (id),
    action INTEGER NOT NULL CHECK (action BETWEEN 0 AND 255),
    count INTEGER NOT NULL CHECK (count >= 1),
    PRIMARY KEY (run, action)
) STRICT, WITHOUT ROWID;

CREATE TRIGGER action_total_is_written_in_the_run BEFORE INSERT ON action_total
WHEN (SELECT status FROM run WHERE id = NEW.run) IS NOT 'running'
BEGIN SELECT RAISE(ABORT, 'results belong to a run in progress'); END;

CREATE TRIGGER action_total_is_fixed BEFORE UPDATE ON action_total
BEGIN SELECT RAISE(ABORT, 'results never change'); END;

CREATE TRIGGER action_total_stays BEFORE DELETE ON action_total
BEGIN SELECT RAISE(ABORT, 'results are never deleted'); END;

CREATE TABLE recorded_step (
    -- A decision in an environment of another family than step_count, whose decisions recorded_decision packs.
    run INTEGER NOT NULL REFERENCES run (id),
    phase INTEGER NOT NULL CHECK (phase IN (0, 1)),             -- 1 in the test
    episode INTEGER NOT NULL CHECK (episode >= 1),
    step INTEGER NOT NULL CHECK (step >= 0),
    available INTEGER NOT NULL CHECK (available IN (0, 1)),
    can_send INTEGER NOT NULL CHECK (can_send IN (0, 1)),
    chosen_action INTEGER NOT NULL CHECK (chosen_action BETWEEN 0 AND 255),
    action INTEGER NOT NULL CHECK (action BETWEEN 0 AND 255),
    action_probability REAL NOT NULL CHECK (action_probability BETWEEN 0 AND 1),
    -- A JSON array of the probabilities of all actions; NULL where only that of the chosen action is known.
    action_probabilities TEXT CHECK (json_type(action_probabilities) = 'array'),
    reward REAL NOT NULL CHECK (abs(reward) <= 1.7976931348623157e308),
    -- A JSON object: the names and numbers of the state before the step.
    state TEXT NOT NULL CHECK (json_type(state) = 'object'),
    PRIMARY KEY (run, phase, episode, step)
) STRICT, WITHOUT ROWID;

CREATE TRIGGER recorded_step_is_written_in_the_run BEFORE INSERT ON recorded_step
WHEN (SELECT status FROM run WHERE id = NEW.run) IS NOT 'running'
BEGIN SELECT RAISE(ABORT, 'results belong to a run in progress'); END;

CREATE TRIGGER recorded_step_is_fixed BEFORE UPDATE ON recorded_step
BEGIN SELECT RAISE(ABORT, 'results never change'); END;

CREATE TRIGGER recorded_step_stays BEFORE DELETE ON recorded_step
BEGIN SELECT RAISE(ABORT, 'results are never deleted'); END;

CREATE TABLE recorded_description (
    -- How the environment of a run described itself, if it is not known in advance: JSON.
    run INTEGER PRIMARY KEY REFERENCES run (id),
    description TEXT NOT NULL CHECK (json_type(description) = 'object')
) STRICT;

CREATE TRIGGER recorded_description_is_written_in_the_run BEFORE INSERT ON recorded_description
WHEN (SELECT status FROM run WHERE id = NEW.run) IS NOT 'running'
BEGIN SELECT RAISE(ABORT, 'results belong to a run in progress'); END;

CREATE TRIGGER recorded_description_is_fixed BEFORE UPDATE ON recorded_description
BEGIN SELECT RAISE(ABORT, 'results never change'); END;

CREATE TRIGGER recorded_description_stays BEFORE DELETE ON recorded_description
BEGIN SELECT RAISE(ABORT, 'results are never deleted'); END;

DROP TRIGGER run_completes_with_results;

CREATE TRIGGER run_completes_with_results BEFORE UPDATE OF status ON run
WHEN NEW.status = 'completed' AND NOT (
    EXISTS (SELECT 1 FROM test_episode WHERE run = NEW.id)
    AND 3 = (SELECT count(*) FROM metric_name JOIN run_metric ON run = NEW.id AND metric = id
        WHERE name IN ('mean_return', 'sd_return', 'mean_length'))
    AND EXISTS (SELECT 1 FROM metric_name JOIN run_metric ON run = NEW.id AND metric = id
        WHERE name IN ('disengagement_rate', 'termination_rate')))
BEGIN SELECT RAISE(ABORT, 'a completed run has its metrics and test episodes'); END;

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
    OR EXISTS (SELECT 1 FROM recorded_participant
        WHERE id BETWEEN NEW.id << 39 AND (NEW.id << 39) + 549755813887)
    OR EXISTS (SELECT 1 FROM trained_weights WHERE run = NEW.id))
BEGIN SELECT RAISE(ABORT, 'only a completed run has results'); END;

CREATE VIEW action_choice AS
SELECT
    job.key AS job_key,
    action_count.bin / 10.0 AS p_low,
    (action_count.bin + 1) / 10.0 AS p_high,
    action_count.context AS context,
    action_count.action AS action,
    action_count.count AS count
FROM job
JOIN run ON run.job = job.id AND run.status = 'completed'
JOIN action_count ON action_count.run = run.id
UNION ALL
SELECT job.key, NULL, NULL, NULL, action_total.action, action_total.count
FROM job
JOIN run ON run.job = job.id AND run.status = 'completed'
JOIN action_total ON action_total.run = run.id;

DROP VIEW evaluation_episode;

CREATE VIEW evaluation_episode AS
SELECT
    job.key AS job_key,
    test_episode.episode AS episode,
    test_episode.total_reward AS total_reward,
    test_episode.length AS length,
    -- The table keeps the name that the column had before there were families.
    CASE WHEN json_type(job.canonical, '$.environment.family') IS NULL THEN test_episode.disengaged END
        AS disengaged,
    test_episode.disengaged AS terminated
FROM job
JOIN run ON run.job = job.id AND run.status = 'completed'
JOIN test_episode ON test_episode.run = run.id;

DROP VIEW decision;

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
        json_extract(choice.probabilities, '$[' || i || ']') AS action_probabilities
    FROM job
    JOIN run ON run.job = job.id AND run.status = 'completed'
    JOIN recorded_decision AS recorded
        ON recorded.id BETWEEN run.id << 39 AND (run.id << 39) + 549755813887
    LEFT JOIN recorded_choice AS choice ON choice.id = recorded.id
    CROSS JOIN place
    WHERE i < recorded.steps
)
SELECT packed.*, json_object('context', context, 'probability', probability, 'likely_context', likely_context,
    'habituation', habituation, 'disengagement', disengagement) AS state
FROM packed
UNION ALL
SELECT
    job.key, CASE recorded.phase WHEN 0 THEN 'train' ELSE 'test' END, recorded.episode, recorded.step,
    NULL, NULL, NULL, NULL, NULL, recorded.available, recorded.action, recorded.action_probability,
    recorded.reward, recorded.can_send, recorded.chosen_action, recorded.action_probabilities, recorded.state
FROM job
JOIN run ON run.job = job.id AND run.status = 'completed'
JOIN recorded_step AS recorded ON recorded.run = run.id;

DROP VIEW parameter;

CREATE VIEW parameter AS
SELECT
    job.key AS job_key,
    CASE tree.path WHEN '$' THEN tree.key ELSE substr(tree.path, 3) || '.' || tree.key END AS name,
    tree.value AS value
FROM job, json_tree(job.canonical) AS tree
-- The entries of a list have a number for a key; the list itself is the value.
WHERE tree.type <> 'object' AND typeof(tree.key) = 'text'
UNION ALL
SELECT job.key AS job_key, implied.name AS name, implied.value AS value
FROM implied_parameter AS implied
JOIN job ON implied.algorithm IN ('', json_extract(job.canonical, '$.agent.algorithm'))
WHERE json_type(job.canonical, '$.' || implied.name) IS NULL
    -- The environments and participants of other families have other parameters.
    AND (implied.name LIKE 'agent.%' OR implied.name LIKE 'evaluation.%'
        OR json_type(job.canonical, '$.environment.family') IS NULL);

DROP VIEW arm_summary;

CREATE VIEW arm_summary AS
WITH cell (experiment, agent, job, form) AS MATERIALIZED (
    -- The jobs of experiments without scenario and seed, which have columns of their own.
    SELECT held.experiment, held.agent, held.job, json_remove(job.canonical, '$.scenario', '$.seed')
    FROM experiment_job AS held
    JOIN job ON job.id = held.job
), distinct_cell (experiment, agent, form) AS MATERIALIZED (
    -- Few beside the jobs, because most differ in scenario and seed alone.
    SELECT DISTINCT experiment, agent, form FROM cell
), given (experiment, agent, form, name, value) AS MATERIALIZED (
    SELECT cell.experiment, cell.agent, cell.form, substr(tree.path, 3) || '.' || tree.key, tree.value
    FROM distinct_cell AS cell
    JOIN json_tree(cell.form) AS tree
    WHERE tree.type <> 'object' AND typeof(tree.key) = 'text'
    UNION ALL
    SELECT cell.experiment, cell.agent, cell.form, implied.name, implied.value
    FROM distinct_cell AS cell
    JOIN implied_parameter AS implied
        ON implied.algorithm IN ('', json_extract(cell.form, '$.agent.algorithm'))
    WHERE json_type(cell.form, '$.' || implied.name) IS NULL
        AND (implied.name LIKE 'agent.%' OR implied.name LIKE 'evaluation.%'
            OR json_type(cell.form, '$.environment.family') IS NULL)
), varying (experiment, agent, name) AS MATERIALIZED (
    -- The parameters of which the jobs of an agent have several values in an experiment.
    SELECT experiment, agent, name FROM given
    GROUP BY experiment, agent, name
    HAVING min(value) IS NOT max(value)
), swept (experiment, agent, form, name, value) AS MATERIALIZED (
    SELECT given.experiment, given.agent, given.form, given.name, given.value
    FROM varying
    JOIN given ON (given.experiment, given.agent, given.name)
        = (varying.experiment, varying.agent, varying.name)
), arm (experiment, agent, form, swept, label) AS MATERIALIZED (
    SELECT cell.experiment, cell.agent, cell.form,
        (SELECT json_group_object(name, value) FROM (
            SELECT swept.name, swept.value FROM swept
            WHERE (swept.experiment, swept.agent, swept.form) = (cell.experiment, cell.agent, cell.form)
            ORDER BY swept.name)),
        ifnull((SELECT group_concat(word, ' ') FROM (
            SELECT substr(swept.name, instr(swept.name, '.') + 1) || '='
                || CASE typeof(swept.value) WHEN 'real' THEN printf('%.15g', swept.value)
                    ELSE swept.value END AS word
            FROM swept
            WHERE (swept.experiment, swept.agent, swept.form) = (cell.experiment, cell.agent, cell.form)
            ORDER BY swept.name)), '')
    FROM distinct_cell AS cell
)
SELECT
    experiment.name AS experiment,
    cell.agent AS agent,
    json_extract(job.canonical, '$.scenario') AS scenario,
    json_extract(job.canonical, '$.environment.sigma') AS sigma,
    arm.swept AS swept,
    arm.label AS label,
    json_extract(job.canonical, '$.seed') AS seed,
    job.key AS job_key,
    (SELECT value FROM run_metric WHERE run = run.id
        AND metric = (SELECT id FROM metric_name WHERE name = 'mean_return')) AS mean_return,
    (SELECT value FROM run_metric WHERE run = run.id
        AND metric = (SELECT id FROM metric_name WHERE name = 'sd_return')
        AND EXISTS (SELECT 1 FROM test_episode WHERE test_episode.run = run.id AND episode = 2))
        AS sd_return,
    (SELECT value FROM run_metric WHERE run = run.id
        AND metric = (SELECT id FROM metric_name WHERE name = 'mean_length')) AS mean_length,
    (SELECT value FROM run_metric WHERE run = run.id
        AND metric = (SELECT id FROM metric_name WHERE name = 'disengagement_rate'))
        AS disengagement_rate,
    (SELECT value FROM run_metric WHERE run = run.id
        AND metric = (SELECT id FROM metric_name WHERE name = 'message_rate')) AS message_rate
FROM cell
JOIN arm ON (arm.experiment, arm.agent, arm.form) = (cell.experiment, cell.agent, cell.form)
JOIN experiment ON experiment.id = cell.experiment
JOIN job ON job.id = cell.job
LEFT JOIN run ON run.job = job.id AND run.status = 'completed';
