-- What version 6 adds: a run whose participants differ.
INSERT INTO job (id, key, environment_version, algorithm_version, canonical) VALUES
    (6, '600102030405060708090a0b0c0d0e0f', 1, 1,
        '{"agent":{"algorithm":"rule","rule":"random"},"environment":{"sigma":0.6},"evaluation":{"test_episodes":1},"population":{"delta_d":"{ uniform = [0.0, 0.2] }"},"scenario":"L-T","seed":6}');
INSERT INTO experiment_job (experiment, job, agent, position) VALUES (1, 6, 'random', 6);
INSERT INTO run (id, job, attempt, session, status, started_at) VALUES
    (7, 6, 1, 2, 'running', '2026-02-01T08:32:03.000Z');
INSERT INTO run_metric (run, metric, value) VALUES (7, 1, 42.6), (7, 2, 0.0), (7, 3, 1.0), (7, 4, 0.0);
INSERT INTO test_episode (run, episode, total_reward, length, disengaged) VALUES (7, 1, 42.6, 1, 0);
INSERT INTO recorded_participant (id, value) VALUES ((7 << 39) + (1 << 38) + (1 << 14) + 3, 0.125);
UPDATE run SET status = 'completed', ended_at = '2026-02-01T08:33:01.000Z', wall_seconds = 58.0,
    results_sha256 = x'0000000000000000000000000000000000000000000000000000000000000000' WHERE id = 7;
