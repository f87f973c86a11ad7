-- What version 7 adds: a run whose outside program failed.
INSERT INTO job (id, key, environment_version, algorithm_version, canonical) VALUES
    (7, '700102030405060708090a0b0c0d0e0f', 1, 1,
        '{"agent":{"algorithm":"external","command":["false"],"episodes":1,"version":"1"},"environment":{"sigma":0.6},"evaluation":{"test_episodes":1},"scenario":"L-T","seed":7}');
INSERT INTO experiment_job (experiment, job, agent, position) VALUES (1, 7, 'outside', 7);
INSERT INTO run (id, job, attempt, session, status, started_at) VALUES
    (8, 7, 1, 2, 'running', '2026-02-01T08:34:03.000Z');
UPDATE run SET status = 'failed', ended_at = '2026-02-01T08:34:04.000Z', wall_seconds = 1.0,
    failure_kind = 'external', failure_message = 'it exited with code 1', failure_episode = 0,
    results_sha256 = x'0000000000000000000000000000000000000000000000000000000000000000' WHERE id = 8;
