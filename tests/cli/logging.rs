//! `log`: the commands that changed a store.

use crate::support::{Effort, Folder, manifest};

#[test]
fn commands_that_change_a_store_are_recorded_once() {
    let folder = Folder::with(&manifest("sweep", "0.6", "1", Effort::Trivial));
    folder.jitai(["run", "sweep.toml", "--quiet"]).succeeded();
    // These change nothing.
    folder.jitai(["run", "sweep.toml"]).succeeded();
    folder.jitai(["forget", "sweep"]).ended(2);
    folder.jitai(["status"]).succeeded();
    folder.jitai(["forget", "sweep", "--yes"]).succeeded();
    let log = folder.jitai(["log", "--format", "csv"]).succeeded();
    let rows: Vec<&str> = log.stdout.lines().skip(1).collect();
    let commands = ["jitai run sweep.toml --quiet", "jitai forget sweep --yes"];
    assert_eq!(rows.len(), commands.len(), "{}", log.stdout);
    for (row, command) in rows.iter().zip(commands) {
        assert!(row.contains(&format!(",{command},")), "{row}");
    }
}
