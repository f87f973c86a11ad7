-- How many equally weighted decisions say as much about the value of a policy as the weighted ones do.

-- NULL for an effect.
ALTER TABLE recorded_estimate ADD COLUMN effective_sample_size REAL CHECK (effective_sample_size >= 0);
