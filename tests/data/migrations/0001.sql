-- A little of everything that version 1 can hold: an experiment with a completed, a failed, an
-- interrupted and a running job.
INSERT INTO experiment (id, name, question, hypothesis, manifest, created_at, updated_at) VALUES
    (1, 'quickstart', 'Does it learn?', NULL, 'format = 1', '2026-01-31T12:00:00.000Z', '2026-02-01T08:30:00.250Z');

INSERT INTO job (id, key, environment_version, algorithm_version, canonical) VALUES
    (1, '000102030405060708090a0b0c0d0e0f', 1, 1,
        '{"agent":{"algorithm":"dueling_dqn","episodes":1000,"layers":[128,128]},"environment":{"mu":[0.1,0.1],"sigma":0.4,"time_one_hot":false},"evaluation":{"test_episodes":2},"scenario":"P-H-D","seed":1}'),
    (2, '100102030405060708090a0b0c0d0e0f', 1, 1,
        '{"agent":{"algorithm":"reinforce","episodes":15000},"environment":{"sigma":0.6},"evaluation":{"test_episodes":2},"scenario":"L-T","seed":2}'),
    (3, '200102030405060708090a0b0c0d0e0f', 1, 1,
        '{"agent":{"algorithm":"reinforce","episodes":15000},"environment":{"sigma":0.6},"evaluation":{"test_episodes":2},"scenario":"L-T","seed":3}');

INSERT INTO experiment_job (experiment, job, agent, position) VALUES
    (1, 1, 'dqn', 0), (1, 2, 'reinforce', 1), (1, 3, 'reinforce', 2);

INSERT INTO session (id, host, boot_id, pid_namespace, process_id, process_started, code_version, git_revision, backend, processor, started_at, heartbeat_at, ended_at) VALUES
    (1, 'lab', '314a304d-6828-4926-b2a1-60a7be7a2fde', 'pid:[4026531836]', 4711, 86487, '0.1.0', 'abc1234', 'ndarray 0.22.1', 'a processor', '2026-01-31T12:00:00.000Z', '2026-01-31T13:00:00.000Z', NULL),
    (2, 'lab', NULL, NULL, 4712, NULL, '0.1.0', 'abc1234', 'ndarray 0.22.1', 'a processor', '2026-02-01T08:30:00.000Z', '2026-02-01T08:31:00.000Z', NULL);

INSERT INTO run (id, job, attempt, session, status, started_at) VALUES
    (1, 1, 1, 1, 'running', '2026-01-31T12:00:01.000Z'),
    (2, 2, 1, 1, 'running', '2026-01-31T12:00:02.000Z'),
    (3, 3, 1, 1, 'running', '2026-01-31T12:00:03.000Z');

INSERT INTO metric_name (id, name) VALUES (1, 'mean_return'), (2, 'sd_return'), (3, 'mean_length'), (4, 'disengagement_rate');
INSERT INTO run_metric (run, metric, value) VALUES (1, 1, 2583.5), (1, 2, 96.25), (1, 3, 28.5), (1, 4, 0.5);
INSERT INTO curve_point (run, metric, episode, value) VALUES (1, 1, 10, 1200.0), (1, 1, 20, 1300.5);
INSERT INTO test_episode (run, episode, total_reward, length, disengaged) VALUES (1, 1, 2500.0, 50, 0), (1, 2, 310.0, 7, 1);
INSERT INTO action_count (run, bin, context, action, count) VALUES (1, 0, 1, 3, 40), (1, 9, 0, 2, 17);
INSERT INTO trained_weights (run, safetensors) VALUES (1, x'0800000000000000');

UPDATE run SET status = 'completed', ended_at = '2026-01-31T12:10:00.000Z', wall_seconds = 599.0,
    results_sha256 = x'0000000000000000000000000000000000000000000000000000000000000000' WHERE id = 1;
UPDATE run SET status = 'failed', ended_at = '2026-01-31T12:11:00.000Z', wall_seconds = 658.0,
    failure_kind = 'diverged', failure_message = 'the loss is not a number', failure_episode = 17,
    results_sha256 = x'0000000000000000000000000000000000000000000000000000000000000000' WHERE id = 2;
UPDATE run SET status = 'interrupted', ended_at = '2026-01-31T13:00:00.000Z', wall_seconds = 3597.0 WHERE id = 3;
UPDATE session SET ended_at = '2026-01-31T13:00:00.000Z' WHERE id = 1;

INSERT INTO run (id, job, attempt, session, status, started_at) VALUES
    (4, 3, 2, 2, 'running', '2026-02-01T08:30:01.000Z');
