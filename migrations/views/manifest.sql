CREATE VIEW manifest AS
SELECT
    experiment.name AS experiment,
    used.used_from AS used_from,
    used.used_until AS used_until,
    used.manifest AS manifest,
    -- Ids count in the order in which texts were replaced. The instants need not, because a clock can be
    -- set back.
    row_number() OVER (PARTITION BY experiment.id ORDER BY used.id IS NULL, used.id) AS number
FROM experiment
JOIN (
    SELECT id, experiment, used_from, used_until, manifest FROM earlier_manifest
    UNION ALL
    SELECT NULL, id, updated_at, NULL, manifest FROM experiment
) AS used ON used.experiment = experiment.id;
