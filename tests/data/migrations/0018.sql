-- What version 18 adds: a filtered command, the files of a program, and a treatment that varies.
INSERT INTO session (id, host, process_id, code_version, git_revision, backend, processor, started_at, heartbeat_at, filter)
    VALUES (18, 'node', 18, '0.1.0', 'abc', 'flex', 'cpu', '2026-02-01T08:38:00.000Z', '2026-02-01T08:38:00.000Z', 'sigma=0.4');
INSERT INTO run (id, job, attempt, session, status, started_at, programs)
    SELECT 18, job.id, 18, 18, 'running', '2026-02-01T08:38:03.000Z', '{"own.py":"00"}' FROM job
    WHERE NOT EXISTS (SELECT 1 FROM run WHERE run.job = job.id AND run.status IN ('running', 'completed')) LIMIT 1;
INSERT INTO recorded_estimate (run, declaration, number, term, estimate, standard_error, degrees_of_freedom, low, high,
    p_value, decisions, residual_sd, treatment_variance, sha256) VALUES
    (9, 2, 2, '2', 1.5, 0.5, 30.0, 0.5, 2.5, 0.01, 900, 4.0, 0.21,
        x'0000000000000000000000000000000000000000000000000000000000000000');
