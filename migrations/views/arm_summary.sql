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
                || CASE typeof(swept.value) WHEN 'real' THEN replace(replace(
                    replace(printf('%.15g', swept.value), 'e-0', 'e-'), 'e+0', 'e'), 'e+', 'e')
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
        AND metric = (SELECT id FROM metric_name WHERE name = 'message_rate')) AS message_rate,
    ifnull((SELECT value FROM run_metric WHERE run = run.id
        AND metric = (SELECT id FROM metric_name WHERE name = 'mean_net_return')),
        (SELECT value FROM run_metric WHERE run = run.id
        AND metric = (SELECT id FROM metric_name WHERE name = 'mean_return'))) AS mean_net_return
FROM cell
JOIN arm ON (arm.experiment, arm.agent, arm.form) = (cell.experiment, cell.agent, cell.form)
JOIN experiment ON experiment.id = cell.experiment
JOIN job ON job.id = cell.job
LEFT JOIN run ON run.job = job.id AND run.status = 'completed';
