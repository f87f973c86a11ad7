-- What version 4 adds: a run whose decisions are recorded.
INSERT INTO job (id, key, environment_version, algorithm_version, canonical) VALUES
    (5, '400102030405060708090a0b0c0d0e0f', 1, 1,
        '{"agent":{"algorithm":"rule","rule":"random"},"environment":{"sigma":0.6},"evaluation":{"record_decisions":"test","test_episodes":1},"scenario":"L-T","seed":5}');
INSERT INTO experiment_job (experiment, job, agent, position) VALUES (1, 5, 'random', 4);
INSERT INTO run (id, job, attempt, session, status, started_at) VALUES
    (6, 5, 1, 2, 'running', '2026-02-01T08:30:03.000Z');
INSERT INTO run_metric (run, metric, value) VALUES (6, 1, 42.6), (6, 2, 0.0), (6, 3, 1.0), (6, 4, 0.0);
INSERT INTO test_episode (run, episode, total_reward, length, disengaged) VALUES (6, 1, 42.6, 1, 0);
INSERT INTO recorded_decision (id, steps, bits, probability_0, habituation_0, disengagement_0,
    action_probability_0, reward_0) VALUES
    ((6 << 39) + (1 << 38) + (1 << 14), 1, 13, 0.25, 0.1, 0.1, 0.25, 42.6);
UPDATE run SET status = 'completed', ended_at = '2026-02-01T08:31:01.000Z', wall_seconds = 58.0,
    results_sha256 = x'0000000000000000000000000000000000000000000000000000000000000000' WHERE id = 6;
