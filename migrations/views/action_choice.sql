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
