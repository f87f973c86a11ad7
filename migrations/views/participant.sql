CREATE VIEW participant AS
SELECT
    job.key AS job_key,
    CASE recorded.id >> 38 & 1 WHEN 0 THEN 'train' ELSE 'test' END AS phase,
    recorded.id >> 14 & 16777215 AS episode,
    -- The places of the parameters never change.
    CASE recorded.id & 16383
        WHEN 0 THEN 'sigma'
        WHEN 1 THEN 'delta_h'
        WHEN 2 THEN 'epsilon_h'
        WHEN 3 THEN 'delta_d'
        WHEN 4 THEN 'epsilon_d'
        WHEN 5 THEN 'rho_1'
        WHEN 6 THEN 'rho_2'
        WHEN 7 THEN 'rho_3'
        WHEN 8 THEN 'mu'
        WHEN 9 THEN 'mu_0'
        WHEN 10 THEN 'mu_1'
        WHEN 11 THEN 'initial_habituation'
        WHEN 12 THEN 'initial_disengagement'
        WHEN 13 THEN 'disengagement_threshold'
        WHEN 14 THEN 'state_spread'
        WHEN 15 THEN 'kappa_h'
        WHEN 16 THEN 'kappa_d'
        WHEN 17 THEN 'sigma_s'
        WHEN 18 THEN 'parameter_spread'
        WHEN 19 THEN 'context_probability'
        WHEN 20 THEN 'context_persistence'
        WHEN 21 THEN 'availability'
        WHEN 22 THEN 'message_cost'
    END AS name,
    recorded.value AS value
FROM job
JOIN run ON run.job = job.id AND run.status = 'completed'
JOIN recorded_participant AS recorded
    ON recorded.id BETWEEN run.id << 39 AND (run.id << 39) + 549755813887;
