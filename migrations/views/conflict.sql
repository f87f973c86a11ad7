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
