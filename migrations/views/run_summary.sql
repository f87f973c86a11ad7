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
