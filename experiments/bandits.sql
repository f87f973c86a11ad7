-- The mean return of the first n people, in steps, over the seeds of experiments/bandits.toml.
SELECT s.scenario, CASE noise.value WHEN 'none' THEN 'no' ELSE 'yes' END AS noise, s.agent,
    count(DISTINCT s.seed) AS seeds,
    round(avg(m.value) FILTER (WHERE m.name = 'mean_return_first_10')) AS first_10,
    round(avg(m.value) FILTER (WHERE m.name = 'mean_return_first_50')) AS first_50,
    round(avg(m.value) FILTER (WHERE m.name = 'mean_return_first_140')) AS first_140,
    round(avg(m.value) FILTER (WHERE m.name = 'mean_return_first_500')) AS first_500
FROM run_summary AS s
JOIN parameter AS noise ON noise.job_key = s.job_key AND noise.name = 'environment.state_noise'
JOIN metric AS m ON m.job_key = s.job_key
WHERE s.experiment = 'bandits' AND s.status = 'completed'
GROUP BY s.scenario, noise.value, s.agent
ORDER BY s.scenario, noise, first_140 DESC;
