CREATE VIEW posterior AS
SELECT
    job.key AS job_key,
    recorded.number AS number,
    recorded.step AS step,
    recorded.action AS action,
    recorded.mean AS mean,
    recorded.covariance AS covariance
FROM job
JOIN run ON run.job = job.id AND run.status = 'completed'
JOIN recorded_posterior AS recorded ON recorded.run = run.id;
