-- Every text that the manifest of an experiment had: the view manifest.

CREATE TABLE earlier_manifest (
    -- A text that another one has replaced.
    id INTEGER PRIMARY KEY CHECK (id > 0),
    experiment INTEGER NOT NULL REFERENCES experiment (id),
    manifest TEXT NOT NULL,     -- the file as it was read
    used_from TEXT NOT NULL CHECK (strftime('%Y-%m-%dT%H:%M:%fZ', used_from) IS used_from),
    used_until TEXT NOT NULL CHECK (strftime('%Y-%m-%dT%H:%M:%fZ', used_until) IS used_until),
    -- Of the experiment's name and the other columns, so that a change of them on the disk is seen.
    sha256 BLOB NOT NULL CHECK (length(sha256) = 32)
) STRICT;

CREATE INDEX earlier_manifest_by_experiment ON earlier_manifest (experiment);

CREATE TRIGGER earlier_manifest_is_fixed BEFORE UPDATE ON earlier_manifest
BEGIN SELECT RAISE(ABORT, 'an earlier manifest never changes'); END;

CREATE TRIGGER earlier_manifest_stays BEFORE DELETE ON earlier_manifest
BEGIN SELECT RAISE(ABORT, 'an earlier manifest is never deleted'); END;

CREATE VIEW manifest AS
SELECT
    experiment.name AS experiment,
    used.used_from AS used_from,
    used.used_until AS used_until,
    used.manifest AS manifest
FROM experiment
JOIN (
    SELECT experiment, used_from, used_until, manifest FROM earlier_manifest
    UNION ALL
    SELECT id, updated_at, NULL, manifest FROM experiment
) AS used ON used.experiment = experiment.id;
