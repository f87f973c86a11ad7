//! A job that needs too much memory is a failed run, and the other jobs continue.

use crate::support::{Finished, Folder};

/// A manifest with an agent with these keys, and with an agent that needs little memory.
fn greedy(keys: &str) -> String {
    format!(
        "format = 1
name = \"sweep\"
scenarios = [\"C-L-P-H-D-T\"]
seeds = 1
environment = {{ sigma = 0.6, horizon = 400, delta_d = 0.0, epsilon_d = 0.0 }}
evaluation.test_episodes = 20
evaluation.curve_stride = 100_000
[[agent]]
name = \"greedy\"
{keys}
[[agent]]
name = \"modest\"
algorithm = \"reinforce\"
episodes = 10
layers = [8]
"
    )
}

/// Runs the sweep with this much address space. Threads share one arena of the C library, because
/// further arenas would reserve 64 MB of address space each, depending on chance.
fn run_within(folder: &Folder, kilobytes: u32, workers: u32) -> Finished {
    let program = env!("CARGO_BIN_EXE_jitai");
    let script =
        format!("ulimit -v {kilobytes}; exec {program} run sweep.toml --workers {workers}");
    let mut shell = folder.command_of("sh", ["-c", &script]);
    let output = shell.env("MALLOC_ARENA_MAX", "1").output().unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    Finished {
        code: output.status.code(),
        stdout: text(&output.stdout),
        stderr: text(&output.stderr),
    }
}

/// Asserts that the greedy job failed for lack of memory for `what`, and that the other job completed.
#[track_caller]
fn assert_one_was_refused(folder: &Folder, ended: Finished, what: &str) {
    ended.ended(1).prints("out_of_memory").prints(what);
    let refused = format!(
        "SELECT count(*) FROM run_summary WHERE agent = 'greedy' AND failure_kind = 'out_of_memory'
         AND failure_message LIKE 'out of memory for {what}, which needs at least % bytes; %'"
    );
    assert_eq!(folder.number(&refused), 1);
    let completed =
        "SELECT count(*) FROM run_summary WHERE agent = 'modest' AND status = 'completed'";
    assert_eq!(folder.number(completed), 1);
    folder.jitai(["status"]).succeeded().prints("out_of_memory").prints(what);
    folder.jitai(["doctor"]).succeeded();
}

/// Ten million transitions take 330 MB.
const BUFFER: &str = "algorithm = \"dueling_dqn\"\nepisodes = 1_000_000\nlayers = [4]\n\
    batch = 8\nbuffer = 10_000_000\ntarget_period = 1_000_000_000";

#[test]
#[cfg(target_os = "linux")]
fn a_replay_buffer_that_outgrows_the_memory_is_a_failed_row() {
    let folder = Folder::with(&greedy(BUFFER));
    let ended = run_within(&folder, 64_000, 1);
    assert_one_was_refused(&folder, ended, "the replay buffer");
    let told = "SELECT count(*) FROM run WHERE failure_kind = 'out_of_memory'
        AND failure_episode > 1000 AND wall_seconds > 0";
    assert_eq!(folder.number(told), 1);
}

#[test]
#[cfg(target_os = "linux")]
fn a_network_that_is_too_large_for_the_memory_is_a_failed_row_and_can_be_tried_again() {
    let huge = "algorithm = \"dueling_dqn\"\nepisodes = 10\nlayers = [4096, 4096]";
    let folder = Folder::with(&greedy(huge));
    let ended = run_within(&folder, 250_000, 2);
    assert_one_was_refused(&folder, ended, "the network");
    run_within(&folder, 250_000, 1).ended(1).says("0 jobs run, 1 completed in all, 1 failed");
    assert_eq!(folder.runs(), 2);
}

#[test]
#[cfg(target_os = "linux")]
fn trajectories_that_outgrow_the_memory_are_a_failed_row() {
    let many = "algorithm = \"reinforce\"\nepisodes = 1_000_000\nlayers = [4]\n\
        trajectories_per_update = 10_000";
    let folder = Folder::with(&greedy(many));
    let ended = run_within(&folder, 96_000, 1);
    assert_one_was_refused(&folder, ended, "the trajectories of an update");
}
