-- What version 9 adds: a run whose decisions have the probabilities of all actions.
INSERT INTO job (id, key, environment_version, algorithm_version, canonical) VALUES
    (8, '900102030405060708090a0b0c0d0e0f', 1, 1,
        '{"agent":{"algorithm":"rule","rule":"random"},"environment":{"sigma":0.6},"evaluation":{"record_decisions":"test","test_episodes":1},"scenario":"L-T","seed":9}');
INSERT INTO experiment_job (experiment, job, agent, position) VALUES (1, 8, 'random', 8);
INSERT INTO run (id, job, attempt, session, status, started_at) VALUES
    (9, 8, 1, 2, 'running', '2026-02-01T08:34:03.000Z');
INSERT INTO run_metric (run, metric, value) VALUES (9, 1, 42.6), (9, 2, 0.0), (9, 3, 1.0), (9, 4, 0.0);
INSERT INTO test_episode (run, episode, total_reward, length, disengaged) VALUES (9, 1, 42.6, 1, 0);
INSERT INTO recorded_decision (id, steps, bits, probability_0, habituation_0, disengagement_0,
    action_probability_0, reward_0) VALUES
    ((9 << 39) + (1 << 38) + (1 << 14), 1, 13, 0.25, 0.1, 0.1, 0.25, 42.6);
INSERT INTO recorded_choice (id, bits, probabilities) VALUES
    ((9 << 39) + (1 << 38) + (1 << 14), 5, '[[0.25,0.25,0.25,0.25]]');
UPDATE run SET status = 'completed', ended_at = '2026-02-01T08:35:01.000Z', wall_seconds = 58.0,
    results_sha256 = x'0000000000000000000000000000000000000000000000000000000000000000' WHERE id = 9;
