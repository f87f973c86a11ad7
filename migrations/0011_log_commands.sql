-- Which command changed the store, and when.

CREATE TABLE recorded_command (
    -- A command that changed the store, recorded with its first change.
    id INTEGER PRIMARY KEY CHECK (id > 0),
    changed_at TEXT NOT NULL CHECK (strftime('%Y-%m-%dT%H:%M:%fZ', changed_at) IS changed_at),
    command TEXT NOT NULL,      -- its words, quoted for a shell
    folder TEXT NOT NULL,       -- the working folder, from which relative paths start
    host TEXT NOT NULL,
    code_version TEXT NOT NULL,
    git_revision TEXT NOT NULL
) STRICT;

CREATE TRIGGER recorded_command_is_fixed BEFORE UPDATE ON recorded_command
BEGIN SELECT RAISE(ABORT, 'a command that was recorded never changes'); END;

CREATE TRIGGER recorded_command_stays BEFORE DELETE ON recorded_command
BEGIN SELECT RAISE(ABORT, 'a command that was recorded is never deleted'); END;
