-- What version 19 adds: a run with the posteriors of people after an update of a trial.
INSERT INTO job (id, key, environment_version, algorithm_version, canonical) VALUES
    (19, 'e00102030405060708090a0b0c0d0e0f', 1, 1,
        '{"agent":{"algorithm":"rule","rule":"random"},"environment":{"command":["program"],"family":"external","version":"1"},"evaluation":{"record_posteriors":true,"test_episodes":1},"scenario":"all","seed":19}');
INSERT INTO experiment_job (experiment, job, agent, position) VALUES (1, 19, 'random', 19);
INSERT INTO run (id, job, attempt, session, status, started_at) VALUES
    (19, 19, 1, 2, 'running', '2026-02-01T08:38:03.000Z');
INSERT INTO run_metric (run, metric, value) VALUES (19, 1, 1.5), (19, 2, 0.0), (19, 3, 1.0);
INSERT INTO run_metric (run, metric, value) SELECT 19, id, 1.0 FROM metric_name WHERE name = 'termination_rate';
INSERT INTO test_episode (run, episode, total_reward, length, disengaged) VALUES (19, 1, 1.5, 1, 1);
INSERT INTO action_total (run, action, count) VALUES (19, 4, 1);
INSERT INTO recorded_person (run, number, person, action, step, mean, covariance, deviation) VALUES
    (19, 1, 0, 1, 14, '[1.5,-0.25]', '[4.0,0.5,0.5,1.0]', '[0.5,0.125]'),
    (19, 1, 1, 1, 14, '[1.25,0.0]', '[2.0,0.25,0.25,0.5]', '[]');
UPDATE run SET status = 'completed', ended_at = '2026-02-01T08:39:01.000Z', wall_seconds = 58.0,
    results_sha256 = x'0000000000000000000000000000000000000000000000000000000000000000' WHERE id = 19;
