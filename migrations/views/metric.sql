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
