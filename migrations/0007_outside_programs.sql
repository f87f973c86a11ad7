-- Agents that are outside programs fail in a way of their own.

INSERT INTO failure_kind (name, meaning) VALUES
    ('external', 'its outside program was not started, ended early or broke the protocol');
