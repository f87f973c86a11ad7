-- What version 15 adds: a run with two recorded training episodes, one of which was terminated and one running at the end.
INSERT INTO job (id, key, environment_version, algorithm_version, canonical) VALUES
    (11, 'c00102030405060708090a0b0c0d0e0f', 1, 1,
        '{"agent":{"algorithm":"reinforce","episodes":2},"environment":{"sigma":0.6},"evaluation":{"record_decisions":"all","test_episodes":1},"scenario":"L-T","seed":11}');
INSERT INTO experiment_job (experiment, job, agent, position) VALUES (1, 11, 'reinforce', 11);
INSERT INTO run (id, job, attempt, session, status, started_at) VALUES
    (12, 11, 1, 2, 'running', '2026-02-01T08:36:03.000Z');
INSERT INTO run_metric (run, metric, value) VALUES (12, 1, 42.6), (12, 2, 0.0), (12, 3, 1.0), (12, 4, 0.0);
INSERT INTO test_episode (run, episode, total_reward, length, disengaged) VALUES (12, 1, 42.6, 1, 0);
INSERT INTO recorded_decision (id, steps, bits, probability_0, habituation_0, disengagement_0,
    action_probability_0, reward_0) VALUES
    ((12 << 39) + (1 << 14), 1, 13, 0.25, 0.1, 0.1, 0.25, 42.6),
    ((12 << 39) + (2 << 14), 1, 13, 0.25, 0.1, 0.1, 0.25, 42.6),
    ((12 << 39) + (1 << 38) + (1 << 14), 1, 13, 0.25, 0.1, 0.1, 0.25, 42.6);
INSERT INTO recorded_ending (id, length, ending) VALUES
    ((12 << 39) + (1 << 14), 1, 1),
    ((12 << 39) + (2 << 14), 1, 0);
UPDATE run SET status = 'completed', ended_at = '2026-02-01T08:37:01.000Z', wall_seconds = 58.0,
    results_sha256 = x'0000000000000000000000000000000000000000000000000000000000000000' WHERE id = 12;
