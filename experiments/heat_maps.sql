-- How close the tiles of the paper's heat maps (mean return in P-H-D minus L-H-D) are by each reading
-- of the observations: ours minus the published tiles, in the mean and as a root mean square, in
-- steps; and the root mean square that noise alone would make, by the spread of our seeds, where the
-- published tiles are over three. `make readings` runs it.
WITH published(agent, delta_d, epsilon_d, effect) AS (
    VALUES
        ('dqn', 0.1, 0.1, 232.4), ('dqn', 0.1, 0.2, 347.7),
        ('dqn', 0.1, 0.3, 618.2), ('dqn', 0.1, 0.4, 792.7),
        ('dqn', 0.2, 0.1, 244.9), ('dqn', 0.2, 0.2, 257.5),
        ('dqn', 0.2, 0.3, 383.8), ('dqn', 0.2, 0.4, 509.3),
        ('dqn', 0.3, 0.1, 233.0), ('dqn', 0.3, 0.2, 242.9),
        ('dqn', 0.3, 0.3, 350.5), ('dqn', 0.3, 0.4, 394.7),
        ('dqn', 0.4, 0.1, 221.7), ('dqn', 0.4, 0.2, 223.8),
        ('dqn', 0.4, 0.3, 297.9), ('dqn', 0.4, 0.4, 323.4),
        ('reinforce', 0.1, 0.1, 24.9), ('reinforce', 0.1, 0.2, 189.3),
        ('reinforce', 0.1, 0.3, 383.4), ('reinforce', 0.1, 0.4, 576.2),
        ('reinforce', 0.2, 0.1, 29.8), ('reinforce', 0.2, 0.2, 67.9),
        ('reinforce', 0.2, 0.3, 276.4), ('reinforce', 0.2, 0.4, 425.5),
        ('reinforce', 0.3, 0.1, 32.0), ('reinforce', 0.3, 0.2, 70.3),
        ('reinforce', 0.3, 0.3, 156.3), ('reinforce', 0.3, 0.4, 349.9),
        ('reinforce', 0.4, 0.1, 17.0), ('reinforce', 0.4, 0.2, 1.5),
        ('reinforce', 0.4, 0.3, 158.6), ('reinforce', 0.4, 0.4, 317.9)
), run AS (
    SELECT s.agent, s.scenario, s.mean_return, one_hot.value AS time_one_hot,
        delta_d.value AS delta_d, epsilon_d.value AS epsilon_d
    FROM run_summary AS s
    JOIN parameter AS one_hot ON one_hot.job_key = s.job_key
        AND one_hot.name = 'environment.time_one_hot'
    JOIN parameter AS delta_d ON delta_d.job_key = s.job_key
        AND delta_d.name = 'environment.delta_d'
    JOIN parameter AS epsilon_d ON epsilon_d.job_key = s.job_key
        AND epsilon_d.name = 'environment.epsilon_d'
    WHERE s.experiment = 'heat-maps' AND s.status = 'completed'
), arm AS (
    SELECT agent, time_one_hot, delta_d, epsilon_d, scenario, count(*) AS seeds,
        avg(mean_return) AS mean_return, stddev(mean_return) AS deviation
    FROM run
    GROUP BY agent, time_one_hot, delta_d, epsilon_d, scenario
), tile AS (
    SELECT p.agent, p.time_one_hot, min(p.seeds, l.seeds) AS seeds,
        p.mean_return - l.mean_return - published.effect AS difference,
        p.deviation * p.deviation * (1.0 / p.seeds + 1.0 / 3)
            + l.deviation * l.deviation * (1.0 / l.seeds + 1.0 / 3) AS noise
    FROM arm AS p
    JOIN arm AS l USING (agent, time_one_hot, delta_d, epsilon_d)
    JOIN published USING (agent, delta_d, epsilon_d)
    WHERE p.scenario = 'P-H-D' AND l.scenario = 'L-H-D'
)
SELECT agent, time_one_hot, count(*) AS tiles, min(seeds) AS seeds, round(avg(difference)) AS mean,
    round(sqrt(avg(difference * difference))) AS root_mean_square,
    round(sqrt(avg(noise))) AS by_noise_alone
FROM tile
GROUP BY agent, time_one_hot
ORDER BY agent, time_one_hot;
