-- What version 8 adds: a manifest that replaced an earlier text.
INSERT INTO earlier_manifest (experiment, manifest, used_from, used_until, sha256) VALUES
    (1, 'format = 1', '2026-01-01T00:00:00.000Z', '2026-01-02T00:00:00.000Z',
        x'0000000000000000000000000000000000000000000000000000000000000000');
