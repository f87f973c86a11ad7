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
WHERE json_type(job.canonical, '$.' || implied.name) IS NULL
    -- The environments and participants of other families have other parameters.
    AND (implied.name LIKE 'agent.%' OR implied.name LIKE 'evaluation.%'
        OR json_type(job.canonical, '$.environment.family') IS NULL);
