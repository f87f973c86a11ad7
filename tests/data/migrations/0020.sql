-- What version 20 adds: an estimate with an effective sample size.
INSERT INTO recorded_estimate (run, declaration, number, term, estimate, standard_error, degrees_of_freedom, low, high,
    p_value, decisions, residual_sd, effective_sample_size, sha256) VALUES
    (9, 2, 3, 'self_normalised', 1.5, 0.5, 30.0, 0.5, 2.5, 0.01, 900, 4.0, 412.5,
        x'0000000000000000000000000000000000000000000000000000000000000000');
