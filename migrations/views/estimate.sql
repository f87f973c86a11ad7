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
    declared.canonical AS declaration,
    experiment.name AS experiment,
    held.agent AS agent,
    recorded.treatment_variance AS treatment_variance,
    recorded.effective_sample_size AS effective_sample_size
FROM job
JOIN run ON run.job = job.id AND run.status = 'completed'
JOIN recorded_estimate AS recorded ON recorded.run = run.id
JOIN estimate_declaration AS declared ON declared.id = recorded.declaration
JOIN experiment_job AS held ON held.job = job.id
JOIN experiment ON experiment.id = held.experiment
WHERE CASE
    -- Where a manifest did not say: of each name, the declaration that was added last.
    WHEN experiment.estimates IS NULL THEN NOT EXISTS (
        SELECT 1 FROM recorded_estimate AS other
        JOIN estimate_declaration AS newer ON newer.id = other.declaration
        WHERE other.run = run.id AND newer.id > declared.id
            AND json_extract(newer.canonical, '$.name') = json_extract(declared.canonical, '$.name'))
    ELSE EXISTS (
        SELECT 1 FROM json_each(experiment.estimates) AS tree
        WHERE json_extract(tree.value, '$[0]') = held.agent
            AND json_extract(tree.value, '$[1]') = declared.canonical) END;
