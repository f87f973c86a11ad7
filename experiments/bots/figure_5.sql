-- Our curves beside figure 5 of BOTS: means of every hundred of episodes, in steps, over the runs
-- that are not stuck; a run is stuck if its mean return from episode 1001 on is below 1400 and its agent is `ts`,
-- which starts from the uninformative prior. `error` is our standard error over runs, `published_error` an upper
-- limit of theirs: the mean standard error of one episode. `low` and `high` bound the difference: 2.1 times both
-- errors together, a 95 % interval for twenty runs, or wider, as theirs is an upper limit. `ahead` is by how many
-- episodes the published curve is taken to be ahead: 2 as if the two rounds that the figure shows as 0 had been
-- played, where the last hundred of ours has 98 episodes. The verdict is on Thompson sampling alone; the settings
-- of the deep agents are known from the text.
WITH published(agent, first, mean_return, standard_error) AS (
    -- Means of figure_5.csv.
    VALUES ('dqn', 1, 1804.5, 74.8), ('dqn', 101, 3078.6, 20.4), ('dqn', 201, 3088.8, 27.1),
        ('dqn', 301, 3065.9, 34.3), ('dqn', 401, 3034.1, 55.3), ('dqn', 501, 3015.0, 52.3),
        ('dqn', 601, 2964.0, 62.1), ('dqn', 701, 2907.3, 78.4), ('dqn', 801, 2932.7, 65.7),
        ('dqn', 901, 2923.0, 59.6), ('dqn', 1001, 2916.5, 57.9), ('dqn', 1101, 2926.7, 55.1),
        ('dqn', 1201, 2934.8, 49.4), ('dqn', 1301, 2952.3, 46.5), ('dqn', 1401, 2928.5, 46.2),
        ('ppo', 1, 1510.3, 167.7), ('ppo', 101, 2529.8, 162.5), ('ppo', 201, 2903.6, 103.2),
        ('ppo', 301, 2916.7, 77.7), ('ppo', 401, 2709.6, 250.1), ('ppo', 501, 2570.9, 293.0),
        ('ppo', 601, 2583.9, 258.1), ('ppo', 701, 2685.0, 183.6), ('ppo', 801, 2584.4, 237.8),
        ('ppo', 901, 2624.7, 237.8), ('ppo', 1001, 2509.2, 288.4), ('ppo', 1101, 2587.5, 237.2),
        ('ppo', 1201, 2523.5, 253.6), ('ppo', 1301, 2566.5, 236.9), ('ppo', 1401, 2549.8, 228.6),
        ('reinforce', 1, 584.6, 102.3), ('reinforce', 101, 787.7, 123.8), ('reinforce', 201, 1123.7, 144.0),
        ('reinforce', 301, 1492.2, 158.7), ('reinforce', 401, 1824.4, 159.4), ('reinforce', 501, 2080.5, 141.9),
        ('reinforce', 601, 2265.0, 132.2), ('reinforce', 701, 2397.5, 110.2), ('reinforce', 801, 2508.9, 101.7),
        ('reinforce', 901, 2577.5, 97.8), ('reinforce', 1001, 2604.3, 92.5), ('reinforce', 1101, 2678.7, 78.4),
        ('reinforce', 1201, 2741.6, 80.4), ('reinforce', 1301, 2769.9, 75.3), ('reinforce', 1401, 2785.5, 73.9),
        ('ts', 1, 1543.9, 20.2), ('ts', 101, 1613.3, 3.0), ('ts', 201, 1614.1, 3.4),
        ('ts', 301, 1616.2, 4.0), ('ts', 401, 1619.5, 4.4), ('ts', 501, 1620.3, 4.9),
        ('ts', 601, 1622.7, 5.3), ('ts', 701, 1624.5, 5.2), ('ts', 801, 1629.4, 6.3),
        ('ts', 901, 1631.0, 6.4), ('ts', 1001, 1632.1, 7.0), ('ts', 1101, 1635.1, 6.8),
        ('ts', 1201, 1636.9, 7.5), ('ts', 1301, 1639.4, 7.5), ('ts', 1401, 1640.6, 7.3),
        ('ts-trial', 1, 1596.9, 3.6), ('ts-trial', 101, 1610.9, 3.2), ('ts-trial', 201, 1613.0, 3.2),
        ('ts-trial', 301, 1614.3, 3.6), ('ts-trial', 401, 1616.4, 3.6), ('ts-trial', 501, 1619.1, 3.8),
        ('ts-trial', 601, 1620.8, 3.8), ('ts-trial', 701, 1624.4, 3.9), ('ts-trial', 801, 1626.6, 4.3),
        ('ts-trial', 901, 1627.9, 4.0), ('ts-trial', 1001, 1630.4, 4.2), ('ts-trial', 1101, 1632.1, 4.5),
        ('ts-trial', 1201, 1633.3, 4.7), ('ts-trial', 1301, 1636.5, 4.8), ('ts-trial', 1401, 1636.7, 4.8)
), point AS (
    -- The trial's ten episodes stand before the first of the figure.
    SELECT s.experiment, s.agent, s.job_key, c.value,
        c.episode - CASE s.agent WHEN 'ts-trial' THEN 10 ELSE 0 END AS episode
    FROM run_summary AS s
    JOIN learning_curve AS c ON c.job_key = s.job_key AND c.metric = 'mean_return'
    WHERE s.experiment IN ('bots-figure-5', 'bots-figure-5-readings') AND s.status = 'completed'
), shift(experiment, ahead) AS (
    VALUES ('bots-figure-5', 0), ('bots-figure-5-readings', 0), ('bots-figure-5-readings', 2)
), stuck AS (
    SELECT job_key FROM point WHERE agent = 'ts' AND episode > 1000
    GROUP BY job_key HAVING avg(value) < 1400
), setting AS (
    SELECT job_key, group_concat(name || ' ' || value, ', ' ORDER BY name) AS reading
    FROM parameter
    WHERE (name, value) IN (VALUES ('agent.gamma', 1.0), ('agent.terminal_target', 'standard'),
            ('agent.at_horizon', 'truncation'))
        OR name = 'agent.epochs'
    GROUP BY job_key
), run AS (
    SELECT p.experiment, p.agent, coalesce(setting.reading, '') AS reading, shift.ahead, p.job_key,
        (p.episode - shift.ahead - 1) / 100 * 100 + 1 AS first, avg(p.value) AS value,
        p.job_key IN (SELECT job_key FROM stuck) AS is_stuck
    FROM point AS p
    JOIN shift ON shift.experiment = p.experiment
    LEFT JOIN setting ON setting.job_key = p.job_key
    WHERE p.episode - shift.ahead BETWEEN 1 AND 1500
    GROUP BY p.experiment, p.agent, shift.ahead, p.job_key, first
), ours AS (
    SELECT experiment, agent, reading, ahead, first, count(*) AS runs, sum(is_stuck) AS stuck,
        avg(value) FILTER (WHERE NOT is_stuck) AS mean_return,
        sqrt((sum(value * value) FILTER (WHERE NOT is_stuck)
                / count(*) FILTER (WHERE NOT is_stuck)
            - avg(value) FILTER (WHERE NOT is_stuck) * avg(value) FILTER (WHERE NOT is_stuck))
            / (count(*) FILTER (WHERE NOT is_stuck) - 1)) AS standard_error
    FROM run
    GROUP BY experiment, agent, reading, ahead, first
), compared AS (
    SELECT ours.*, published.mean_return AS theirs, published.standard_error AS their_error,
        ours.mean_return - published.mean_return AS difference,
        2.1 * sqrt(ours.standard_error * ours.standard_error
            + published.standard_error * published.standard_error) AS margin
    FROM ours
    JOIN published ON published.first = ours.first
        AND (ours.agent = published.agent
            OR ours.agent LIKE published.agent || '-%' AND published.agent IN ('ppo', 'reinforce'))
)
SELECT agent, reading, ahead, first AS from_episode, runs, stuck,
    round(mean_return, 1) AS ours, round(standard_error, 1) AS error,
    theirs AS published, their_error AS published_error,
    round(difference, 1) AS difference, round(difference - margin, 1) AS low,
    round(difference + margin, 1) AS high,
    CASE
        WHEN agent NOT LIKE 'ts%' OR first = 1 THEN ''
        WHEN abs(difference) <= 15 THEN 'within 15'
        ELSE 'outside'
    END AS verdict
FROM compared
ORDER BY experiment, agent, reading, ahead, first;
