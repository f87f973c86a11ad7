-- What version 17 adds: the estimates that a manifest declares, one of the two that a run has.
UPDATE experiment SET estimates = json_array(json_array('random',
    '{"control":[],"estimator":"wcls","moderators":["context"],"name":"effect","numerator":0.5,"outcome":"reward","treatment":"any message"}'))
    WHERE id = 1;
