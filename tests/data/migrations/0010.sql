-- What version 10 adds: other results of a job, which a merge found.
INSERT INTO recorded_conflict (job, results_sha256, found_at, source, host, processor, code_version, git_revision) VALUES
    (1, x'0100000000000000000000000000000000000000000000000000000000000000', '2026-02-02T00:00:00.000Z', 'theirs.sqlite',
        'other', 'another processor', '0.1.0', 'abc1234');
