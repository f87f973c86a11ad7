-- A job can leave out its episodes (`record_episodes = "none"`); its metrics are those of all of them.
DROP TRIGGER run_completes_with_results;

CREATE TRIGGER run_completes_with_results BEFORE UPDATE OF status ON run
WHEN NEW.status = 'completed' AND NOT (
    2 = (SELECT count(*) FROM metric_name JOIN run_metric ON run = NEW.id AND metric = id
        WHERE name IN ('mean_return', 'mean_length'))
    AND EXISTS (SELECT 1 FROM metric_name JOIN run_metric ON run = NEW.id AND metric = id
        WHERE name IN ('disengagement_rate', 'termination_rate'))
    AND ('none' IS (SELECT json_extract(canonical, '$.evaluation.record_episodes') FROM job WHERE id = NEW.job)
        OR EXISTS (SELECT 1 FROM test_episode WHERE run = NEW.id)
            AND EXISTS (SELECT 1 FROM metric_name JOIN run_metric ON run = NEW.id AND metric = id
                WHERE name = 'sd_return')))
BEGIN SELECT RAISE(ABORT, 'a completed run has its metrics and test episodes'); END;

-- The standard deviation of one episode is undefined, and the tables keep 0 for it.
DROP VIEW run_summary;

CREATE VIEW run_summary AS
SELECT
    experiment.name AS experiment,
    job.key AS job_key,
    experiment_job.agent AS agent,
    json_extract(job.canonical, '$.scenario') AS scenario,
    json_extract(job.canonical, '$.environment.sigma') AS sigma,
    json_extract(job.canonical, '$.seed') AS seed,
    -- A killed process cannot say so; its heartbeat stops.
    CASE WHEN run.status = 'running' AND (
            session.ended_at IS NOT NULL
            OR session.heartbeat_at < strftime('%Y-%m-%dT%H:%M:%fZ', 'now', '-30 seconds'))
        THEN 'interrupted' ELSE run.status END AS status,
    run.attempt AS attempt,
    (SELECT value FROM run_metric WHERE run = run.id
        AND metric = (SELECT id FROM metric_name WHERE name = 'mean_return')) AS mean_return,
    (SELECT value FROM run_metric WHERE run = run.id
        AND metric = (SELECT id FROM metric_name WHERE name = 'sd_return')
        AND (SELECT max(episode) FROM test_episode WHERE test_episode.run = run.id) IS NOT 1)
        AS sd_return,
    (SELECT value FROM run_metric WHERE run = run.id
        AND metric = (SELECT id FROM metric_name WHERE name = 'mean_length')) AS mean_length,
    (SELECT value FROM run_metric WHERE run = run.id
        AND metric = (SELECT id FROM metric_name WHERE name = 'disengagement_rate'))
        AS disengagement_rate,
    run.wall_seconds AS wall_seconds,
    run.started_at AS started_at,
    run.ended_at AS ended_at,
    session.code_version AS code_version,
    run.failure_kind AS failure_kind,
    run.failure_message AS failure_message,
    session.host AS host,
    session.processor AS processor,
    session.backend AS backend,
    session.git_revision AS git_revision
FROM run
JOIN job ON job.id = run.job
JOIN session ON session.id = run.session
JOIN experiment_job ON experiment_job.job = job.id
JOIN experiment ON experiment.id = experiment_job.experiment;

DROP VIEW metric;

CREATE VIEW metric AS
SELECT
    job.key AS job_key,
    metric_name.name AS name,
    CASE WHEN metric_name.name <> 'sd_return'
        OR (SELECT max(episode) FROM test_episode WHERE test_episode.run = run.id) IS NOT 1
        THEN run_metric.value END AS value
FROM job
JOIN run ON run.job = job.id AND run.status = 'completed'
JOIN run_metric ON run_metric.run = run.id
JOIN metric_name ON metric_name.id = run_metric.metric;

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
        AND (SELECT max(episode) FROM test_episode WHERE test_episode.run = run.id) IS NOT 1)
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

-- In a trial, decisions of step_count have more state than the packed rows hold.
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
    CAST(json_extract(recorded.state, '$.context') AS INTEGER),
    json_extract(recorded.state, '$.probability'),
    CAST(json_extract(recorded.state, '$.likely_context') AS INTEGER),
    json_extract(recorded.state, '$.habituation'),
    json_extract(recorded.state, '$.disengagement'), recorded.available, recorded.action, recorded.action_probability,
    recorded.reward, recorded.can_send, recorded.chosen_action, recorded.action_probabilities, recorded.state
FROM job
JOIN run ON run.job = job.id AND run.status = 'completed'
JOIN recorded_step AS recorded ON recorded.run = run.id;
