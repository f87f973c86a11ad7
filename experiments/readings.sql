-- How close each reading of the paper comes to its published curves at sigma 0.6, over the scenarios
-- of readings.toml: the difference of every mean from the published one, their root mean square and
-- their mean, in steps. `make readings` asks it. A part of every difference is the noise of the
-- published means, which are over three seeds.
WITH published(agent, scenario, mean_return) AS (
    VALUES ('dqn', 'P-H-D', 2630), ('dqn', 'L-H-D', 1871), ('dqn', 'P-T', 1191),
        ('reinforce', 'P-H-D', 2337), ('reinforce', 'L-H-D', 1827), ('reinforce', 'P-T', 2227)
), setting AS (
    -- What a reading is called: the agent, and what its environment or test changes.
    SELECT job_key, group_concat(name || ' ' || value, ', ') AS changed
    FROM parameter
    WHERE (name, value) IN (
        VALUES ('environment.time_one_hot', 1), ('environment.first_context', 'sampled'),
            ('environment.observed_probability', 1), ('environment.initial_habituation', 0.0),
            ('evaluation.test_actions', 'greedy')
    )
    GROUP BY job_key
), arm AS (
    SELECT s.agent, coalesce(setting.changed, 'as published') AS changed, s.scenario,
        count(*) AS seeds, avg(s.mean_return) AS mean_return
    FROM run_summary AS s
    LEFT JOIN setting ON setting.job_key = s.job_key
    WHERE s.experiment = 'readings' AND s.status = 'completed'
    GROUP BY s.agent, setting.changed, s.scenario
), compared AS (
    SELECT arm.*, arm.mean_return - published.mean_return AS difference
    FROM arm
    JOIN published ON published.scenario = arm.scenario
        AND (arm.agent = published.agent OR arm.agent LIKE published.agent || '-%')
)
SELECT agent, changed, min(seeds) AS seeds,
    round(sum(difference) FILTER (WHERE scenario = 'P-H-D')) AS "P-H-D",
    round(sum(difference) FILTER (WHERE scenario = 'L-H-D')) AS "L-H-D",
    round(sum(difference) FILTER (WHERE scenario = 'P-T')) AS "P-T",
    round(sqrt(avg(difference * difference))) AS root_mean_square, round(avg(difference)) AS mean
FROM compared
GROUP BY agent, changed
ORDER BY substr(agent, 1, 3), root_mean_square;
