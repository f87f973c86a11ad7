CREATE VIEW person_posterior AS
SELECT
    job.key AS job_key,
    recorded.number AS number,
    recorded.step AS step,
    recorded.person AS person,
    recorded.action AS action,
    recorded.mean AS mean,
    recorded.covariance AS covariance,
    recorded.deviation AS deviation
FROM job
JOIN run ON run.job = job.id AND run.status = 'completed'
JOIN recorded_person AS recorded ON recorded.run = run.id;
