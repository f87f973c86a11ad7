-- How close each reading of the paper comes to its published curves: the difference of every mean
-- from the published one, in steps, with their root mean square and their mean over the scenarios at
-- sigma 0.6; and the differences in P-T at sigma 0 and 1. `make readings` runs it. A part of every
-- difference is the noise of the published means, which are over three seeds: the last two columns
-- are the least and the largest standard error that a mean of three seeds has by the spread of ours,
-- over all means of the row.
WITH published(agent, scenario, sigma, mean_return) AS (
    VALUES ('dqn', 'P-H-D', 0.6, 2630), ('dqn', 'L-H-D', 0.6, 1871), ('dqn', 'P-T', 0.6, 1191),
        ('dqn', 'P-T', 0.0, 1530), ('dqn', 'P-T', 1.0, 730),
        ('reinforce', 'P-H-D', 0.6, 2337), ('reinforce', 'L-H-D', 0.6, 1827),
        ('reinforce', 'P-T', 0.6, 2227), ('reinforce', 'P-T', 0.0, 2979),
        ('reinforce', 'P-T', 1.0, 1416)
), setting AS (
    -- What a reading is called: the agent, and what its environment or test changes.
    SELECT job_key, group_concat(name || ' ' || value, ', ' ORDER BY name) AS changed
    FROM parameter
    WHERE (name, value) IN (
        VALUES ('environment.time_one_hot', 1), ('environment.first_context', 'sampled'),
            ('environment.observed_probability', 1), ('environment.initial_habituation', 0.0),
            ('evaluation.test_actions', 'greedy')
    )
    GROUP BY job_key
), arm AS (
    SELECT s.agent, coalesce(setting.changed, 'as published') AS changed, s.scenario, s.sigma,
        count(*) AS seeds, avg(s.mean_return) AS mean_return,
        sqrt((sum(s.mean_return * s.mean_return) - sum(s.mean_return) * avg(s.mean_return))
            / (count(*) - 1) / 3) AS standard_error_of_three
    FROM run_summary AS s
    LEFT JOIN setting ON setting.job_key = s.job_key
    WHERE s.experiment = 'readings' AND s.status = 'completed'
    GROUP BY s.agent, setting.changed, s.scenario, s.sigma
), compared AS (
    SELECT arm.*, arm.mean_return - published.mean_return AS difference
    FROM arm
    JOIN published ON published.scenario = arm.scenario AND published.sigma = arm.sigma
        AND (arm.agent = published.agent OR arm.agent LIKE published.agent || '-%')
)
SELECT agent, changed, min(seeds) AS seeds,
    round(sum(difference) FILTER (WHERE scenario = 'P-H-D')) AS "P-H-D",
    round(sum(difference) FILTER (WHERE scenario = 'L-H-D')) AS "L-H-D",
    round(sum(difference) FILTER (WHERE scenario = 'P-T' AND sigma = 0.6)) AS "P-T",
    round(sqrt(avg(difference * difference) FILTER (WHERE sigma = 0.6))) AS root_mean_square,
    round(avg(difference) FILTER (WHERE sigma = 0.6)) AS mean,
    round(sum(difference) FILTER (WHERE sigma = 0.0)) AS "P-T at 0",
    round(sum(difference) FILTER (WHERE sigma = 1.0)) AS "P-T at 1",
    round(min(standard_error_of_three)) AS least_error_of_three,
    round(max(standard_error_of_three)) AS largest_error_of_three
FROM compared
GROUP BY agent, changed
ORDER BY substr(agent, 1, 3), root_mean_square;
