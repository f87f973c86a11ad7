-- The machine of every run, the results that merges did not copy, the order of manifests, and the standard
-- deviation of one episode, which is undefined.

CREATE TABLE recorded_conflict (
    -- Results that a merge found of a job that has other results here. The store kept its own.
    id INTEGER PRIMARY KEY CHECK (id > 0),
    job INTEGER NOT NULL REFERENCES job (id),
    results_sha256 BLOB NOT NULL CHECK (length(results_sha256) = 32),
    found_at TEXT NOT NULL CHECK (strftime('%Y-%m-%dT%H:%M:%fZ', found_at) IS found_at),
    source TEXT NOT NULL,       -- the path of the store that was merged
    host TEXT NOT NULL,         -- this and the rest: who made the results that were not copied
    processor TEXT NOT NULL,
    code_version TEXT NOT NULL,
    git_revision TEXT NOT NULL,
    UNIQUE (job, results_sha256)
) STRICT;

CREATE TRIGGER recorded_conflict_is_fixed BEFORE UPDATE ON recorded_conflict
BEGIN SELECT RAISE(ABORT, 'a conflict never changes'); END;

CREATE TRIGGER recorded_conflict_stays BEFORE DELETE ON recorded_conflict
BEGIN SELECT RAISE(ABORT, 'a conflict is never deleted'); END;

CREATE TRIGGER recorded_conflict_is_recorded_once BEFORE INSERT ON recorded_conflict
WHEN EXISTS (SELECT 1 FROM recorded_conflict WHERE id = NEW.id
    OR (job = NEW.job AND results_sha256 = NEW.results_sha256))
BEGIN SELECT RAISE(ABORT, 'a conflict is recorded once'); END;

CREATE VIEW conflict AS
SELECT
    job.key AS job_key,
    recorded.found_at AS found_at,
    recorded.source AS source,
    lower(hex(recorded.results_sha256)) AS results_sha256,
    recorded.host AS host,
    recorded.processor AS processor,
    recorded.code_version AS code_version,
    recorded.git_revision AS git_revision,
    lower(hex(run.results_sha256)) AS kept_sha256
FROM recorded_conflict AS recorded
JOIN job ON job.id = recorded.job
JOIN run ON run.job = job.id AND run.status = 'completed'
-- A conflict that came with a merge can be about the results that this store has.
WHERE run.results_sha256 <> recorded.results_sha256;

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
        AND EXISTS (SELECT 1 FROM test_episode WHERE test_episode.run = run.id AND episode = 2))
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

-- The tables keep 0 for the standard deviation of one episode, so that digests stay what they were.
DROP VIEW metric;

CREATE VIEW metric AS
SELECT
    job.key AS job_key,
    metric_name.name AS name,
    CASE WHEN metric_name.name <> 'sd_return'
        OR EXISTS (SELECT 1 FROM test_episode WHERE test_episode.run = run.id AND episode = 2)
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

DROP VIEW manifest;

CREATE VIEW manifest AS
SELECT
    experiment.name AS experiment,
    used.used_from AS used_from,
    used.used_until AS used_until,
    used.manifest AS manifest,
    -- Ids count in the order in which texts were replaced. The instants need not, because a clock can be
    -- set back.
    row_number() OVER (PARTITION BY experiment.id ORDER BY used.id IS NULL, used.id) AS number
FROM experiment
JOIN (
    SELECT id, experiment, used_from, used_until, manifest FROM earlier_manifest
    UNION ALL
    SELECT NULL, id, updated_at, NULL, manifest FROM experiment
) AS used ON used.experiment = experiment.id;
