-- A job can leave out its episodes (`record_episodes = "none"`); its metrics are those of all of them.
DROP TRIGGER run_completes_with_results;

CREATE TRIGGER run_completes_with_results BEFORE UPDATE OF status ON run
WHEN NEW.status = 'completed' AND NOT (
    (EXISTS (SELECT 1 FROM test_episode WHERE run = NEW.id)
        OR 'none' = (SELECT json_extract(canonical, '$.evaluation.record_episodes') FROM job WHERE id = NEW.job))
    AND 2 = (SELECT count(*) FROM metric_name JOIN run_metric ON run = NEW.id AND metric = id
        WHERE name IN ('mean_return', 'mean_length'))
    AND EXISTS (SELECT 1 FROM metric_name JOIN run_metric ON run = NEW.id AND metric = id
        WHERE name IN ('disengagement_rate', 'termination_rate')))
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
