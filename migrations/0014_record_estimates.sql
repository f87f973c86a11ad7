-- Estimates of causal effects from the decisions of a run.

CREATE TABLE estimate_declaration (
    -- A declared estimate, in one line of JSON with sorted keys. Two manifests with the same declaration share it.
    id INTEGER PRIMARY KEY CHECK (id > 0),
    canonical TEXT NOT NULL UNIQUE CHECK (json_type(canonical, '$.name') IS 'text')
) STRICT;

CREATE TRIGGER estimate_declaration_is_fixed BEFORE UPDATE ON estimate_declaration
BEGIN SELECT RAISE(ABORT, 'a declaration never changes'); END;

CREATE TRIGGER estimate_declaration_stays BEFORE DELETE ON estimate_declaration
BEGIN SELECT RAISE(ABORT, 'a declaration is never deleted'); END;

CREATE TRIGGER estimate_declaration_is_made_once BEFORE INSERT ON estimate_declaration
WHEN EXISTS (SELECT 1 FROM estimate_declaration WHERE id = NEW.id OR canonical = NEW.canonical)
BEGIN SELECT RAISE(ABORT, 'a declaration is made once'); END;

CREATE TABLE recorded_estimate (
    -- A term of an estimate. Estimates may be added to a run that is completed, and are no part of its digest.
    run INTEGER NOT NULL REFERENCES run (id),
    declaration INTEGER NOT NULL REFERENCES estimate_declaration (id),
    number INTEGER NOT NULL CHECK (number > 0),     -- the place of the term, from 1
    term TEXT NOT NULL CHECK (term <> ''),
    estimate REAL CHECK (abs(estimate) < 1e308),
    standard_error REAL CHECK (standard_error BETWEEN 0 AND 1e308),
    degrees_of_freedom REAL CHECK (degrees_of_freedom BETWEEN 1 AND 1e308),
    low REAL CHECK (abs(low) < 1e308),
    high REAL CHECK (abs(high) < 1e308),
    p_value REAL CHECK (p_value BETWEEN 0 AND 1),
    decisions INTEGER CHECK (decisions > 0),                -- that the estimate uses
    residual_sd REAL CHECK (residual_sd BETWEEN 0 AND 1e308),   -- weighted
    truth REAL CHECK (abs(truth) < 1e308),                  -- in the simulation of the job; NULL if not simulated
    failure TEXT,               -- why there is no estimate; NULL if there is one
    sha256 BLOB NOT NULL CHECK (length(sha256) = 32),       -- of the row, its job and its declaration
    PRIMARY KEY (run, declaration, number),
    CHECK (iif(failure IS NULL,
        (estimate + standard_error + degrees_of_freedom + low + high + p_value + decisions + residual_sd) IS NOT NULL,
        coalesce(estimate, standard_error, degrees_of_freedom, low, high, p_value, decisions, residual_sd, truth) IS NULL))
) STRICT, WITHOUT ROWID;

CREATE TRIGGER recorded_estimate_is_of_a_completed_run BEFORE INSERT ON recorded_estimate
WHEN (SELECT status FROM run WHERE id = NEW.run) IS NOT 'completed'
BEGIN SELECT RAISE(ABORT, 'estimates belong to a completed run'); END;

CREATE TRIGGER recorded_estimate_is_made_once BEFORE INSERT ON recorded_estimate
WHEN EXISTS (SELECT 1 FROM recorded_estimate
    WHERE (run, declaration, number) = (NEW.run, NEW.declaration, NEW.number))
BEGIN SELECT RAISE(ABORT, 'an estimate is made once'); END;

CREATE TRIGGER recorded_estimate_is_fixed BEFORE UPDATE ON recorded_estimate
BEGIN SELECT RAISE(ABORT, 'an estimate never changes'); END;

CREATE TRIGGER recorded_estimate_stays BEFORE DELETE ON recorded_estimate
BEGIN SELECT RAISE(ABORT, 'an estimate is never deleted'); END;

CREATE VIEW estimate AS
SELECT
    job.key AS job_key,
    json_extract(declared.canonical, '$.name') AS name,
    recorded.term AS term,
    recorded.estimate AS estimate,
    recorded.standard_error AS standard_error,
    recorded.degrees_of_freedom AS degrees_of_freedom,
    recorded.low AS low,
    recorded.high AS high,
    recorded.p_value AS p_value,
    recorded.decisions AS decisions,
    recorded.residual_sd AS residual_sd,
    recorded.truth AS truth,
    recorded.failure AS failure,
    recorded.number AS number,
    declared.canonical AS declaration
FROM job
JOIN run ON run.job = job.id AND run.status = 'completed'
JOIN recorded_estimate AS recorded ON recorded.run = run.id
JOIN estimate_declaration AS declared ON declared.id = recorded.declaration;
