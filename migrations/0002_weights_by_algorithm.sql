-- Which algorithms have weights is known to the program, not to the file: `jitai doctor` asks it.

DROP TRIGGER run_completes_with_results;

-- The four metrics are those of the view run_summary.
CREATE TRIGGER run_completes_with_results BEFORE UPDATE OF status ON run
WHEN NEW.status = 'completed' AND NOT (
    EXISTS (SELECT 1 FROM test_episode WHERE run = NEW.id)
    AND 4 = (SELECT count(*) FROM metric_name JOIN run_metric ON run = NEW.id AND metric = id
        WHERE name IN ('mean_return', 'sd_return', 'mean_length', 'disengagement_rate')))
BEGIN SELECT RAISE(ABORT, 'a completed run has its metrics and test episodes'); END;
