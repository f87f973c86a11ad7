-- What version 16 adds: a run with the posteriors of the effects of messages after two updates of a trial.
INSERT INTO job (id, key, environment_version, algorithm_version, canonical) VALUES
    (12, 'd00102030405060708090a0b0c0d0e0f', 1, 1,
        '{"agent":{"algorithm":"rule","rule":"random"},"environment":{"command":["program"],"family":"external","version":"1"},"evaluation":{"record_posteriors":true,"test_episodes":1},"scenario":"all","seed":12}');
INSERT INTO experiment_job (experiment, job, agent, position) VALUES (1, 12, 'random', 12);
INSERT INTO run (id, job, attempt, session, status, started_at) VALUES
    (13, 12, 1, 2, 'running', '2026-02-01T08:38:03.000Z');
INSERT INTO run_metric (run, metric, value) VALUES (13, 1, 1.5), (13, 2, 0.0), (13, 3, 1.0);
INSERT INTO run_metric (run, metric, value) SELECT 13, id, 1.0 FROM metric_name WHERE name = 'termination_rate';
INSERT INTO test_episode (run, episode, total_reward, length, disengaged) VALUES (13, 1, 1.5, 1, 1);
INSERT INTO action_total (run, action, count) VALUES (13, 4, 1);
INSERT INTO recorded_posterior (run, number, action, step, mean, covariance) VALUES
    (13, 1, 1, 14, '[1.5,-0.25]', '[4.0,0.5,0.5,1.0]'),
    (13, 2, 1, 28, '[1.25,0.0]', '[2.0,0.25,0.25,0.5]');
UPDATE run SET status = 'completed', ended_at = '2026-02-01T08:39:01.000Z', wall_seconds = 58.0,
    results_sha256 = x'0000000000000000000000000000000000000000000000000000000000000000' WHERE id = 13;
