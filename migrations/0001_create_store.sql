-- The first schema. Views at the end are the public part; everything above them may change.
-- Instants are UTC, ISO 8601 with milliseconds: 2026-01-31T12:00:00.000Z.

CREATE TABLE experiment (
    -- A manifest by its name, as it was last run.
    id INTEGER PRIMARY KEY,
    name TEXT NOT NULL UNIQUE CHECK (name <> ''),
    question TEXT,              -- NULL where the author wrote none
    hypothesis TEXT,            -- NULL where the author wrote none
    manifest TEXT NOT NULL,     -- the file as it was read
    created_at TEXT NOT NULL CHECK (strftime('%Y-%m-%dT%H:%M:%fZ', created_at) IS created_at),
    updated_at TEXT NOT NULL CHECK (strftime('%Y-%m-%dT%H:%M:%fZ', updated_at) IS updated_at)
) STRICT;

CREATE TABLE job (
    -- What should run. A job is its content, so a row never changes.
    id INTEGER PRIMARY KEY CHECK (id > 0),
    key TEXT NOT NULL UNIQUE CHECK (length(key) = 32 AND key NOT GLOB '*[^0-9a-f]*'),
    environment_version INTEGER NOT NULL CHECK (environment_version >= 1),
    algorithm_version INTEGER NOT NULL CHECK (algorithm_version >= 1),
    -- Every parameter, as one line of JSON. Parameters stand nowhere else: the views read them
    -- from here, so a new parameter needs no new column.
    canonical TEXT NOT NULL CHECK (json_valid(canonical))
) STRICT;

CREATE TRIGGER job_is_fixed BEFORE UPDATE ON job
BEGIN SELECT RAISE(ABORT, 'a job never changes'); END;

CREATE TRIGGER job_stays BEFORE DELETE ON job
BEGIN SELECT RAISE(ABORT, 'a job is never deleted'); END;

-- INSERT OR REPLACE deletes the rows in its way without the triggers of a deletion, so a table
-- whose rows must stay refuses them before. An id that SQLite chooses is -1 here, and never a row's.
CREATE TRIGGER job_is_made_once BEFORE INSERT ON job
WHEN EXISTS (SELECT 1 FROM job WHERE id = NEW.id)
    OR EXISTS (SELECT 1 FROM job WHERE key = NEW.key)
BEGIN SELECT RAISE(ABORT, 'a job is made once'); END;

CREATE TABLE experiment_job (
    -- The jobs of an experiment's latest manifest. Jobs that an edit dropped lose this row and
    -- nothing else: their runs stay.
    experiment INTEGER NOT NULL REFERENCES experiment (id),
    job INTEGER NOT NULL REFERENCES job (id),
    agent TEXT NOT NULL CHECK (agent <> ''),                    -- its name in this manifest
    position INTEGER NOT NULL CHECK (position >= 0),            -- in the manifest's order
    PRIMARY KEY (experiment, job, agent)
) STRICT, WITHOUT ROWID;

CREATE INDEX experiment_job_by_job ON experiment_job (job);

CREATE TABLE session (
    -- One process that runs jobs: where it lives, and what made the runs.
    id INTEGER PRIMARY KEY CHECK (id > 0),
    host TEXT NOT NULL,
    boot_id TEXT,               -- of the running kernel; NULL where the system has none
    pid_namespace TEXT,         -- in which process_id counts; NULL where the system has none
    process_id INTEGER NOT NULL CHECK (process_id > 0),
    process_started INTEGER,    -- clock ticks from boot to its start; NULL where unknown
    code_version TEXT NOT NULL,
    git_revision TEXT NOT NULL,
    backend TEXT NOT NULL,
    processor TEXT NOT NULL,
    started_at TEXT NOT NULL CHECK (strftime('%Y-%m-%dT%H:%M:%fZ', started_at) IS started_at),
    heartbeat_at TEXT NOT NULL
        CHECK (strftime('%Y-%m-%dT%H:%M:%fZ', heartbeat_at) IS heartbeat_at),
    -- NULL while it lives, and for ever if it was killed.
    ended_at TEXT CHECK (ended_at IS NULL OR strftime('%Y-%m-%dT%H:%M:%fZ', ended_at) IS ended_at)
) STRICT;

CREATE TRIGGER session_stays_the_same_process BEFORE UPDATE OF
    id, host, boot_id, pid_namespace, process_id, process_started, code_version, git_revision,
    backend, processor, started_at ON session
BEGIN SELECT RAISE(ABORT, 'a session stays the same process'); END;

CREATE TRIGGER session_ends_once BEFORE UPDATE ON session WHEN OLD.ended_at IS NOT NULL
BEGIN SELECT RAISE(ABORT, 'an ended session never changes'); END;

CREATE TRIGGER session_stays BEFORE DELETE ON session
BEGIN SELECT RAISE(ABORT, 'a session is never deleted'); END;

CREATE TRIGGER session_begins_once BEFORE INSERT ON session
WHEN EXISTS (SELECT 1 FROM session WHERE id = NEW.id)
BEGIN SELECT RAISE(ABORT, 'a session begins once'); END;

CREATE TABLE failure_kind (
    -- Why a run can fail.
    name TEXT PRIMARY KEY CHECK (name <> ''),
    meaning TEXT NOT NULL
) STRICT, WITHOUT ROWID;

INSERT INTO failure_kind (name, meaning) VALUES
    ('crashed', 'the process that trained it crashed, again and again'),
    ('diverged', 'a loss or weight became infinite or not a number'),
    ('out_of_memory', 'there was no memory for what it needed'),
    ('over_time', 'it took longer than its declared time limit'),
    ('panicked', 'the training code panicked');

CREATE TABLE run (
    -- One attempt at a job.
    id INTEGER PRIMARY KEY CHECK (id > 0),
    job INTEGER NOT NULL REFERENCES job (id),
    attempt INTEGER NOT NULL CHECK (attempt >= 1),
    session INTEGER NOT NULL REFERENCES session (id),
    status TEXT NOT NULL CHECK (status IN ('running', 'completed', 'failed', 'interrupted')),
    started_at TEXT NOT NULL CHECK (strftime('%Y-%m-%dT%H:%M:%fZ', started_at) IS started_at),
    ended_at TEXT CHECK (ended_at IS NULL OR strftime('%Y-%m-%dT%H:%M:%fZ', ended_at) IS ended_at),
    wall_seconds REAL CHECK (wall_seconds IS NULL OR wall_seconds BETWEEN 0 AND 1e300),
    failure_kind TEXT REFERENCES failure_kind (name),
    failure_message TEXT,
    failure_episode INTEGER CHECK (failure_episode >= 0),       -- training episodes before it
    -- Jobs that its process was running when it crashed, this one among them; NULL unless it did.
    suspects INTEGER CHECK (suspects >= 1),
    -- Of all its results, or of its failure, so that a change of them on the disk is seen.
    results_sha256 BLOB CHECK (length(results_sha256) = 32),
    UNIQUE (job, attempt),
    CHECK ((status = 'running') = (ended_at IS NULL)),
    -- A run that was killed has no wall time: nobody was there to measure it.
    CHECK (CASE status
        WHEN 'running' THEN wall_seconds IS NULL
        WHEN 'interrupted' THEN 1
        ELSE wall_seconds IS NOT NULL END),
    CHECK ((status = 'failed') = (failure_kind IS NOT NULL)),
    CHECK ((status = 'failed') = (failure_message IS NOT NULL)),
    CHECK ((status = 'failed') = (failure_episode IS NOT NULL)),
    CHECK (suspects IS NULL OR status = 'interrupted'),
    CHECK ((status IN ('completed', 'failed')) = (results_sha256 IS NOT NULL))
) STRICT;

-- A job runs in one place at a time, and not again once it is completed.
CREATE UNIQUE INDEX run_current ON run (job) WHERE status IN ('running', 'completed');
-- The states of all jobs are read from here, without the runs themselves.
CREATE INDEX run_by_status ON run (status, job, session);

CREATE TABLE metric_name (
    id INTEGER PRIMARY KEY CHECK (id > 0),
    name TEXT NOT NULL UNIQUE CHECK (name <> '')
) STRICT;

CREATE TRIGGER metric_name_is_fixed BEFORE UPDATE ON metric_name
BEGIN SELECT RAISE(ABORT, 'the name of a metric never changes'); END;

CREATE TRIGGER metric_name_stays BEFORE DELETE ON metric_name
BEGIN SELECT RAISE(ABORT, 'the name of a metric is never deleted'); END;

CREATE TRIGGER metric_name_is_given_once BEFORE INSERT ON metric_name
WHEN EXISTS (SELECT 1 FROM metric_name WHERE id = NEW.id OR name = NEW.name)
BEGIN SELECT RAISE(ABORT, 'the name of a metric is given once'); END;

CREATE TABLE run_metric (
    run INTEGER NOT NULL REFERENCES run (id),
    metric INTEGER NOT NULL REFERENCES metric_name (id),
    value REAL NOT NULL CHECK (abs(value) <= 1.7976931348623157e308),
    PRIMARY KEY (run, metric)
) STRICT, WITHOUT ROWID;

CREATE TABLE curve_point (
    run INTEGER NOT NULL REFERENCES run (id),
    metric INTEGER NOT NULL REFERENCES metric_name (id),
    episode INTEGER NOT NULL CHECK (episode >= 1),              -- training episodes finished
    value REAL NOT NULL CHECK (abs(value) <= 1.7976931348623157e308),
    PRIMARY KEY (run, metric, episode)
) STRICT, WITHOUT ROWID;

CREATE TABLE test_episode (
    run INTEGER NOT NULL REFERENCES run (id),
    episode INTEGER NOT NULL CHECK (episode >= 1),
    total_reward REAL NOT NULL CHECK (abs(total_reward) <= 1.7976931348623157e308),
    length INTEGER NOT NULL CHECK (length >= 1),                -- steps of the simulation
    disengaged INTEGER NOT NULL CHECK (disengaged IN (0, 1)),
    PRIMARY KEY (run, episode)
) STRICT, WITHOUT ROWID;

CREATE TABLE action_count (
    run INTEGER NOT NULL REFERENCES run (id),
    bin INTEGER NOT NULL CHECK (bin BETWEEN 0 AND 9),           -- tenths of the probability
    context INTEGER NOT NULL CHECK (context IN (0, 1)),         -- the true one
    action INTEGER NOT NULL CHECK (action BETWEEN 0 AND 3),
    count INTEGER NOT NULL CHECK (count >= 1),
    PRIMARY KEY (run, bin, context, action)
) STRICT, WITHOUT ROWID;

CREATE TABLE trained_weights (
    run INTEGER PRIMARY KEY REFERENCES run (id),
    safetensors BLOB NOT NULL CHECK (length(safetensors) > 0)
) STRICT;

-- A run begins running and ends once. Its results are written while it runs, and it cannot end as
-- anything but completed while it has results: so every run that has ended otherwise has none. That
-- a completed one has all of them is due to the writer, which ends it in the same transaction.

CREATE TRIGGER run_begins_running BEFORE INSERT ON run WHEN NEW.status <> 'running'
BEGIN SELECT RAISE(ABORT, 'a run begins running'); END;

CREATE TRIGGER run_begins_in_a_living_session BEFORE INSERT ON run
WHEN NOT EXISTS (SELECT 1 FROM session WHERE id = NEW.session AND ended_at IS NULL)
BEGIN SELECT RAISE(ABORT, 'a run begins in a session that has not ended'); END;

CREATE TRIGGER run_begins_once BEFORE INSERT ON run
WHEN EXISTS (SELECT 1 FROM run WHERE id = NEW.id)
    OR EXISTS (SELECT 1 FROM run WHERE job = NEW.job AND attempt = NEW.attempt)
BEGIN SELECT RAISE(ABORT, 'a run begins once'); END;

CREATE TRIGGER run_is_the_only_one_of_its_job BEFORE INSERT ON run
WHEN EXISTS (SELECT 1 FROM run WHERE job = NEW.job AND status IN ('running', 'completed'))
BEGIN SELECT RAISE(ABORT, 'a job has one running or completed run'); END;

CREATE TRIGGER run_is_one_attempt BEFORE UPDATE OF id, job, attempt, session, started_at ON run
BEGIN SELECT RAISE(ABORT, 'a run stays the same attempt'); END;

CREATE TRIGGER run_ends_once BEFORE UPDATE ON run WHEN OLD.status <> 'running'
BEGIN SELECT RAISE(ABORT, 'an ended run never changes'); END;

CREATE TRIGGER run_stays BEFORE DELETE ON run
BEGIN SELECT RAISE(ABORT, 'a run is never deleted'); END;

CREATE TRIGGER run_completes_with_results BEFORE UPDATE OF status ON run
WHEN NEW.status = 'completed' AND NOT (
    EXISTS (SELECT 1 FROM test_episode WHERE run = NEW.id)
    -- A rule learns nothing; every other agent has weights.
    AND EXISTS (SELECT 1 FROM trained_weights WHERE run = NEW.id)
        = (SELECT json_extract(canonical, '$.agent.algorithm') IS NOT 'rule' FROM job WHERE id = NEW.job)
    -- The four that the view run_summary shows.
    AND 4 = (SELECT count(*) FROM metric_name
        JOIN run_metric ON run_metric.run = NEW.id AND run_metric.metric = metric_name.id
        WHERE metric_name.name IN ('mean_return', 'sd_return', 'mean_length', 'disengagement_rate')))
BEGIN SELECT RAISE(ABORT, 'a completed run has its metrics, test episodes and weights'); END;

CREATE TRIGGER run_ends_without_results BEFORE UPDATE OF status ON run
WHEN NEW.status IN ('failed', 'interrupted') AND (
    EXISTS (SELECT 1 FROM run_metric WHERE run = NEW.id)
    OR EXISTS (SELECT 1 FROM curve_point WHERE run = NEW.id)
    OR EXISTS (SELECT 1 FROM test_episode WHERE run = NEW.id)
    OR EXISTS (SELECT 1 FROM action_count WHERE run = NEW.id)
    OR EXISTS (SELECT 1 FROM trained_weights WHERE run = NEW.id))
BEGIN SELECT RAISE(ABORT, 'only a completed run has results'); END;

-- What has ended takes no results. The key of each of these tables begins with the run, so INSERT OR
-- REPLACE can only replace rows of a run in progress.
CREATE TRIGGER run_metric_is_written_in_the_run BEFORE INSERT ON run_metric
WHEN (SELECT status FROM run WHERE id = NEW.run) IS NOT 'running'
BEGIN SELECT RAISE(ABORT, 'results belong to a run in progress'); END;
CREATE TRIGGER curve_point_is_written_in_the_run BEFORE INSERT ON curve_point
WHEN (SELECT status FROM run WHERE id = NEW.run) IS NOT 'running'
BEGIN SELECT RAISE(ABORT, 'results belong to a run in progress'); END;
CREATE TRIGGER test_episode_is_written_in_the_run BEFORE INSERT ON test_episode
WHEN (SELECT status FROM run WHERE id = NEW.run) IS NOT 'running'
BEGIN SELECT RAISE(ABORT, 'results belong to a run in progress'); END;
CREATE TRIGGER action_count_is_written_in_the_run BEFORE INSERT ON action_count
WHEN (SELECT status FROM run WHERE id = NEW.run) IS NOT 'running'
BEGIN SELECT RAISE(ABORT, 'results belong to a run in progress'); END;
CREATE TRIGGER trained_weights_are_written_in_the_run BEFORE INSERT ON trained_weights
WHEN (SELECT status FROM run WHERE id = NEW.run) IS NOT 'running'
BEGIN SELECT RAISE(ABORT, 'results belong to a run in progress'); END;

CREATE TRIGGER run_metric_is_fixed BEFORE UPDATE ON run_metric
BEGIN SELECT RAISE(ABORT, 'results never change'); END;
CREATE TRIGGER curve_point_is_fixed BEFORE UPDATE ON curve_point
BEGIN SELECT RAISE(ABORT, 'results never change'); END;
CREATE TRIGGER test_episode_is_fixed BEFORE UPDATE ON test_episode
BEGIN SELECT RAISE(ABORT, 'results never change'); END;
CREATE TRIGGER action_count_is_fixed BEFORE UPDATE ON action_count
BEGIN SELECT RAISE(ABORT, 'results never change'); END;
CREATE TRIGGER trained_weights_are_fixed BEFORE UPDATE ON trained_weights
BEGIN SELECT RAISE(ABORT, 'results never change'); END;

CREATE TRIGGER run_metric_stays BEFORE DELETE ON run_metric
BEGIN SELECT RAISE(ABORT, 'results are never deleted'); END;
CREATE TRIGGER curve_point_stays BEFORE DELETE ON curve_point
BEGIN SELECT RAISE(ABORT, 'results are never deleted'); END;
CREATE TRIGGER test_episode_stays BEFORE DELETE ON test_episode
BEGIN SELECT RAISE(ABORT, 'results are never deleted'); END;
CREATE TRIGGER action_count_stays BEFORE DELETE ON action_count
BEGIN SELECT RAISE(ABORT, 'results are never deleted'); END;
CREATE TRIGGER trained_weights_stay BEFORE DELETE ON trained_weights
BEGIN SELECT RAISE(ABORT, 'results are never deleted'); END;

-- The public views; docs/store.md describes every column.

CREATE VIEW run_summary AS
SELECT
    experiment.name AS experiment,
    job.key AS job_key,
    experiment_job.agent AS agent,
    json_extract(job.canonical, '$.scenario') AS scenario,
    json_extract(job.canonical, '$.environment.sigma') AS sigma,
    json_extract(job.canonical, '$.seed') AS seed,
    -- A killed process cannot say so; its heartbeat stops.
    CASE WHEN run.status = 'running' AND (
            session.ended_at IS NOT NULL
            OR session.heartbeat_at < strftime('%Y-%m-%dT%H:%M:%fZ', 'now', '-30 seconds'))
        THEN 'interrupted' ELSE run.status END AS status,
    run.attempt AS attempt,
    (SELECT value FROM run_metric WHERE run = run.id
        AND metric = (SELECT id FROM metric_name WHERE name = 'mean_return')) AS mean_return,
    (SELECT value FROM run_metric WHERE run = run.id
        AND metric = (SELECT id FROM metric_name WHERE name = 'sd_return')) AS sd_return,
    (SELECT value FROM run_metric WHERE run = run.id
        AND metric = (SELECT id FROM metric_name WHERE name = 'mean_length')) AS mean_length,
    (SELECT value FROM run_metric WHERE run = run.id
        AND metric = (SELECT id FROM metric_name WHERE name = 'disengagement_rate'))
        AS disengagement_rate,
    run.wall_seconds AS wall_seconds,
    run.started_at AS started_at,
    run.ended_at AS ended_at,
    session.code_version AS code_version,
    run.failure_kind AS failure_kind,
    run.failure_message AS failure_message
FROM run
JOIN job ON job.id = run.job
JOIN session ON session.id = run.session
JOIN experiment_job ON experiment_job.job = job.id
JOIN experiment ON experiment.id = experiment_job.experiment;

CREATE VIEW parameter AS
SELECT
    job.key AS job_key,
    CASE tree.path WHEN '$' THEN tree.key ELSE substr(tree.path, 3) || '.' || tree.key END AS name,
    tree.value AS value
FROM job, json_tree(job.canonical) AS tree
-- The entries of a list have a number for a key; the list itself is the value.
WHERE tree.type <> 'object' AND typeof(tree.key) = 'text';

CREATE VIEW metric AS
SELECT job.key AS job_key, metric_name.name AS name, run_metric.value AS value
FROM job
JOIN run ON run.job = job.id AND run.status = 'completed'
JOIN run_metric ON run_metric.run = run.id
JOIN metric_name ON metric_name.id = run_metric.metric;

CREATE VIEW learning_curve AS
SELECT
    job.key AS job_key,
    curve_point.episode AS episode,
    metric_name.name AS metric,
    curve_point.value AS value
FROM job
JOIN run ON run.job = job.id AND run.status = 'completed'
JOIN curve_point ON curve_point.run = run.id
JOIN metric_name ON metric_name.id = curve_point.metric;

CREATE VIEW evaluation_episode AS
SELECT
    job.key AS job_key,
    test_episode.episode AS episode,
    test_episode.total_reward AS total_reward,
    test_episode.length AS length,
    test_episode.disengaged AS disengaged
FROM job
JOIN run ON run.job = job.id AND run.status = 'completed'
JOIN test_episode ON test_episode.run = run.id;

CREATE VIEW action_choice AS
SELECT
    job.key AS job_key,
    action_count.bin / 10.0 AS p_low,
    (action_count.bin + 1) / 10.0 AS p_high,
    action_count.context AS context,
    action_count.action AS action,
    action_count.count AS count
FROM job
JOIN run ON run.job = job.id AND run.status = 'completed'
JOIN action_count ON action_count.run = run.id;
