-- What version 11 adds: the commands that changed the store.
INSERT INTO recorded_command (changed_at, command, folder, host, code_version, git_revision) VALUES
    ('2026-02-03T00:00:00.000Z', 'jitai run sweep.toml', '/home/me', 'here', '0.1.0', 'abc1234');
