-- Version 5 adds a view. An experiment in which a parameter is swept that earlier jobs do not mention.
INSERT INTO experiment_job (experiment, job, agent, position) VALUES (1, 5, 'dqn', 5);
