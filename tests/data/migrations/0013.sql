-- What version 13 adds: a run without episodes.
INSERT INTO job (id, key, environment_version, algorithm_version, canonical) VALUES
    (10, 'b00102030405060708090a0b0c0d0e0f', 1, 1,
        '{"agent":{"algorithm":"rule","rule":"random"},"environment":{"command":["program"],"family":"external","version":"1"},"evaluation":{"record_episodes":"none","test_episodes":1},"scenario":"all","seed":10}');
INSERT INTO experiment_job (experiment, job, agent, position) VALUES (1, 10, 'random', 10);
INSERT INTO run (id, job, attempt, session, status, started_at) VALUES
    (11, 10, 1, 2, 'running', '2026-02-01T08:36:03.000Z');
INSERT INTO run_metric (run, metric, value) VALUES (11, 1, 1.5), (11, 3, 1.0);
INSERT INTO run_metric (run, metric, value) SELECT 11, id, 1.0 FROM metric_name WHERE name = 'termination_rate';
INSERT INTO action_total (run, action, count) VALUES (11, 4, 1);
UPDATE run SET status = 'completed', ended_at = '2026-02-01T08:37:01.000Z', wall_seconds = 58.0,
    results_sha256 = x'0000000000000000000000000000000000000000000000000000000000000000' WHERE id = 11;
