//! Times in seconds, which `make test-times` compares where nothing else runs: with `JITAI_TIMED=1`, tests of
//! the command line also compare theirs with what users were promised.

use std::thread;
use std::time::Duration;

use crate::support::{Effort, Folder, manifest, until};

#[test]
fn time_in_which_the_process_is_stopped_is_no_time_at_work() {
    let text = manifest("sweep", "0.6", "1", Effort::Long);
    let folder = Folder::with(&text);
    let run = folder.start(["run", "sweep.toml", "--workers", "1"]);
    until("a job runs", || folder.is_running_a_job());
    run.signal("STOP");
    thread::sleep(Duration::from_secs(4));
    run.signal("CONT");
    run.wait().succeeded();
    // At most about one second of the stop counts as work.
    let of_stopped = "SELECT count(*) FROM run
        WHERE 86400 * (julianday(ended_at) - julianday(started_at)) - wall_seconds > 2.8";
    assert_eq!(folder.number(of_stopped), 1);
}
