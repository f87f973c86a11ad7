CREATE VIEW every_estimate AS
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
    recorded.treatment_variance AS treatment_variance,
    recorded.effective_sample_size AS effective_sample_size
FROM job
JOIN run ON run.job = job.id AND run.status = 'completed'
JOIN recorded_estimate AS recorded ON recorded.run = run.id
JOIN estimate_declaration AS declared ON declared.id = recorded.declaration;
