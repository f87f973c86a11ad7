-- What version 3 adds: a parameter that the jobs of earlier versions do not mention.
INSERT INTO implied_parameter (name, algorithm, value) VALUES
    ('environment.noise', '', 0.0), ('agent.window', 'reinforce', 3);
