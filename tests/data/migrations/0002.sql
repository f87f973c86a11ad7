-- What version 2 can hold that version 1 refused: a completed run of a trained agent without
-- weights. `jitai doctor` reports it.
INSERT INTO job (id, key, environment_version, algorithm_version, canonical) VALUES
    (4, '300102030405060708090a0b0c0d0e0f', 1, 1,
        '{"agent":{"algorithm":"reinforce","episodes":15000},"environment":{"sigma":0.6},"evaluation":{"test_episodes":1},"scenario":"L-T","seed":4}');
INSERT INTO experiment_job (experiment, job, agent, position) VALUES (1, 4, 'reinforce', 3);
INSERT INTO run (id, job, attempt, session, status, started_at) VALUES
    (5, 4, 1, 2, 'running', '2026-02-01T08:30:02.000Z');
INSERT INTO run_metric (run, metric, value) VALUES (5, 1, 310.0), (5, 2, 0.0), (5, 3, 7.0), (5, 4, 1.0);
INSERT INTO test_episode (run, episode, total_reward, length, disengaged) VALUES (5, 1, 310.0, 7, 1);
UPDATE run SET status = 'completed', ended_at = '2026-02-01T08:31:00.000Z', wall_seconds = 58.0,
    results_sha256 = x'0000000000000000000000000000000000000000000000000000000000000000' WHERE id = 5;
