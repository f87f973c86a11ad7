CREATE VIEW learning_curve AS
SELECT
    job.key AS job_key,
    curve_point.episode AS episode,
    metric_name.name AS metric,
    curve_point.value AS value
FROM job
JOIN run ON run.job = job.id AND run.status = 'completed'
JOIN curve_point ON curve_point.run = run.id
JOIN metric_name ON metric_name.id = curve_point.metric;
