CREATE VIEW evaluation_episode AS
SELECT
    job.key AS job_key,
    test_episode.episode AS episode,
    test_episode.total_reward AS total_reward,
    test_episode.length AS length,
    -- The table keeps the name that the column had before there were families.
    CASE WHEN json_type(job.canonical, '$.environment.family') IS NULL THEN test_episode.disengaged END
        AS disengaged,
    test_episode.disengaged AS terminated
FROM job
JOIN run ON run.job = job.id AND run.status = 'completed'
JOIN test_episode ON test_episode.run = run.id;
