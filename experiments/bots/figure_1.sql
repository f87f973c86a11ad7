-- TS(Update) beside figure 1 of BOTS. `ours` is what the figure shows: the mean over rounds 1, 2, ... of each
-- round's mean return (the trial, round 0, is left out), then over runs. `error` is its standard error over runs;
-- `half_height` is what the figure draws as a band, the standard deviation over rounds and runs together divided
-- by the root of the ten published repetitions.
WITH published(batch, value, half_height) AS (
    VALUES (60, 1535.3, 0.1), (20, 1578.0, 12.1), (10, 1589.1, 9.6), (5, 1594.0, 7.6),
        (4, 1595.1, 7.3), (2, 1597.6, 6.4), (1, 1598.7, 6.3)
), point AS (
    SELECT s.job_key, CAST(p.value AS INTEGER) AS batch, c.episode, c.value,
        -- Round 1 has ten people, whatever the batch.
        CASE WHEN c.episode <= 20 THEN 1 ELSE 2 + (c.episode - 21) / p.value END AS round
    FROM run_summary AS s
    JOIN parameter AS p ON p.job_key = s.job_key AND p.name = 'agent.update_interval'
    JOIN learning_curve AS c ON c.job_key = s.job_key AND c.metric = 'mean_return'
    WHERE s.experiment = 'bots-figure-1' AND s.status = 'completed' AND c.episode > 10
), round AS (
    SELECT job_key, batch, round, avg(value) AS value FROM point GROUP BY job_key, batch, round
), run AS (
    SELECT job_key, batch, avg(value) AS value FROM round GROUP BY job_key, batch
), ours AS (
    SELECT batch, count(*) AS runs, avg(value) AS value,
        sqrt(max(0, avg(value * value) - avg(value) * avg(value)) / (count(*) - 1)) AS standard_error
    FROM run GROUP BY batch
), band AS (
    SELECT batch, sqrt(max(0, avg(value * value) - avg(value) * avg(value)) / 10) AS half_height
    FROM round GROUP BY batch
)
SELECT 120 / batch + 2 AS rounds, batch, runs, round(ours.value, 1) AS ours,
    round(ours.standard_error, 1) AS error, published.value AS published,
    round(ours.value - published.value, 1) AS difference,
    CASE WHEN abs(ours.value - published.value) <= 10 THEN 'within 10' ELSE 'outside' END AS verdict,
    round(band.half_height, 1) AS our_half_height, published.half_height AS published_half_height
FROM ours JOIN band USING (batch) JOIN published USING (batch)
ORDER BY batch DESC;
