-- What version 12 adds: a run in an environment of another family, with its decisions and the environment's description.
INSERT INTO metric_name (id, name) SELECT 1 + max(id), 'termination_rate' FROM metric_name;
INSERT INTO job (id, key, environment_version, algorithm_version, canonical) VALUES
    (9, 'a00102030405060708090a0b0c0d0e0f', 1, 1,
        '{"agent":{"algorithm":"rule","rule":"random"},"environment":{"command":["program"],"family":"external","version":"1"},"evaluation":{"record_decisions":"test","test_episodes":1},"scenario":"all","seed":9}');
INSERT INTO experiment_job (experiment, job, agent, position) VALUES (1, 9, 'random', 9);
INSERT INTO run (id, job, attempt, session, status, started_at) VALUES
    (10, 9, 1, 2, 'running', '2026-02-01T08:36:03.000Z');
INSERT INTO run_metric (run, metric, value) VALUES (10, 1, 1.5), (10, 2, 0.0), (10, 3, 1.0);
INSERT INTO run_metric (run, metric, value) SELECT 10, id, 1.0 FROM metric_name WHERE name = 'termination_rate';
INSERT INTO test_episode (run, episode, total_reward, length, disengaged) VALUES (10, 1, 1.5, 1, 1);
INSERT INTO action_total (run, action, count) VALUES (10, 4, 1);
INSERT INTO recorded_step (run, phase, episode, step, available, can_send, chosen_action, action, action_probability,
    action_probabilities, reward, state) VALUES
    (10, 1, 1, 0, 1, 1, 4, 4, 0.2, '[0.2,0.2,0.2,0.2,0.2]', 1.5, '{"interest":0.5}');
INSERT INTO recorded_description (run, description) VALUES
    (10, '{"features":[{"name":"burden"}],"actions":["a","b","c","d","e"],"horizon":5,"state":["interest"],"availability":false,"participants":false}');
UPDATE run SET status = 'completed', ended_at = '2026-02-01T08:37:01.000Z', wall_seconds = 58.0,
    results_sha256 = x'0000000000000000000000000000000000000000000000000000000000000000' WHERE id = 10;
