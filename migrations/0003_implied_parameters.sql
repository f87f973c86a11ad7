-- Parameters that were added after jobs had been stored: a job at the value that all earlier jobs had
-- does not write the parameter into its canonical form, so that its key stays what it was.

CREATE TABLE implied_parameter (
    -- The value of a parameter in every job whose canonical form does not mention it. The program
    -- keeps these rows up to date when it opens the store to write.
    name TEXT NOT NULL CHECK (name <> ''),                      -- dotted, as in the view parameter
    algorithm TEXT NOT NULL,                                    -- that has it; '' for all
    value ANY NOT NULL,
    PRIMARY KEY (name, algorithm)
) STRICT, WITHOUT ROWID;

DROP VIEW parameter;

CREATE VIEW parameter AS
SELECT
    job.key AS job_key,
    CASE tree.path WHEN '$' THEN tree.key ELSE substr(tree.path, 3) || '.' || tree.key END AS name,
    tree.value AS value
FROM job, json_tree(job.canonical) AS tree
-- The entries of a list have a number for a key; the list itself is the value.
WHERE tree.type <> 'object' AND typeof(tree.key) = 'text'
UNION ALL
SELECT job.key AS job_key, implied.name AS name, implied.value AS value
FROM implied_parameter AS implied
JOIN job ON implied.algorithm IN ('', json_extract(job.canonical, '$.agent.algorithm'))
WHERE json_type(job.canonical, '$.' || implied.name) IS NULL;
