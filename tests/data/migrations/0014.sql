-- What version 14 adds: an estimate of two terms of a run, and one that could not be computed.
INSERT INTO estimate_declaration (id, canonical) VALUES
    (1, '{"control":[],"estimator":"wcls","moderators":["context"],"name":"effect","numerator":0.5,"outcome":"reward","treatment":"any message"}'),
    (2, '{"control":[],"estimator":"wcls","moderators":[],"name":"failed","numerator":0.5,"outcome":"reward","treatment":2}');
INSERT INTO recorded_estimate (run, declaration, number, term, estimate, standard_error, degrees_of_freedom, low, high,
    p_value, decisions, residual_sd, truth, failure, sha256) VALUES
    (9, 1, 1, '1', 1.5, 0.5, 30.0, 0.5, 2.5, 0.01, 900, 4.0, 1.25, NULL,
        x'0000000000000000000000000000000000000000000000000000000000000000'),
    (9, 1, 2, 'context', 2.5, 0.5, 30.0, 1.5, 3.5, 0.001, 900, 4.0, NULL, NULL,
        x'0000000000000000000000000000000000000000000000000000000000000000'),
    (9, 2, 1, '1', NULL, NULL, NULL, NULL, NULL, NULL, NULL, NULL, NULL, 'too few people',
        x'0000000000000000000000000000000000000000000000000000000000000000');
