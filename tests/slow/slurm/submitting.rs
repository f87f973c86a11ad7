//! Submission, and a controller that does not answer.

use std::fs;
use std::thread;
use std::time::Duration;

use super::cluster::{Lab, until};
use crate::support::{Effort, manifest};

fn jobs(seeds: &str, effort: Effort) -> String {
    manifest("submitted", "0.6", seeds, effort).replace("episodes = 4000\n", "episodes = 1000\n")
}

#[test]
fn the_controller_down_for_30_s_during_submit() {
    let Some(lab) = Lab::with(&jobs("4", Effort::Short), "chunk_minutes = 0.01") else { return };
    // The controller is down from the moment at which sbatch is called.
    let asked = lab.folder.path("asked");
    let body = format!(
        "[ -e {asked} ] || {{ touch {asked}; while [ ! -e {asked}.down ]; do sleep 0.1; done; }}\n\
         exec sbatch \"$@\"",
        asked = asked.display()
    );
    let submitting = lab.submit_with_program("sbatch", &body);
    until("sbatch is called", || asked.exists());
    lab.cluster.kill_controller();
    fs::write(lab.folder.path("asked.down"), "").unwrap();
    thread::sleep(Duration::from_secs(30));
    lab.cluster.start_controller();
    submitting.wait().succeeded().prints("submitted ");
    lab.finish();
    assert_eq!(lab.submissions().len(), 1, "nothing was submitted twice");
}

#[test]
fn the_controller_down_for_30_s_during_status() {
    let Some(lab) = Lab::waiting("") else { return };
    lab.submit(&[]).succeeded();
    lab.until_all_run();
    lab.cluster.kill_controller();
    let status = lab.jitai(&["status"]).succeeded().says("the state on the cluster is unknown");
    assert!(status.stdout.contains("unknown"), "{}", status.stdout);
    let shown = &lab.submissions()[0];
    assert_eq!(shown["state"], "unknown");
    assert_eq!((&shown["unknown"], &shown["finished"]), (&3.into(), &0.into()));
    // Jobs in an unknown state are not submitted again.
    lab.submit(&[]).ended(3);
    assert_eq!(lab.submissions().len(), 1);
    thread::sleep(Duration::from_secs(30));
    lab.cluster.start_controller();
    lab.folder.write("go", "");
    lab.finish();
    assert_eq!(lab.submissions().len(), 1);
}

#[test]
fn submit_killed_before_sbatch() {
    let Some(lab) = Lab::with(&jobs("4", Effort::Short), "chunk_minutes = 0.01") else { return };
    let killed = lab.submit_with_program("sbatch", "kill -9 $PPID; exit 1").wait();
    assert_eq!(killed.code, None);
    let shown = &lab.submissions()[0];
    assert_eq!((&shown["finished"], &shown["lost"]), (&0.into(), &shown["chunks"]), "{shown}");
    lab.submit(&["--wait"]).succeeded().says("never reached the cluster");
    lab.assert_as_on_one_machine();
    assert_eq!(lab.submissions()[0]["state"], "abandoned");
}

#[test]
fn submit_killed_after_sbatch() {
    let Some(lab) = Lab::in_three_chunks(&jobs("3", Effort::Long), "") else { return };
    let killed = lab.submit_with_program("sbatch", "sbatch \"$@\"; kill -9 $PPID").wait();
    assert_eq!(killed.code, None);
    assert!(!lab.submission().join("array").exists());
    lab.submit(&[]).succeeded().prints("nothing to submit").says("6 held by the cluster");
    assert!(lab.submission().join("array").exists(), "it was found by its name");
    lab.finish();
    assert_eq!(lab.submissions().len(), 1, "nothing was submitted twice");
    assert_eq!(lab.attempts().len(), 3);
}

#[test]
fn a_manifest_edited_while_its_submission_runs() {
    let Some(lab) = Lab::with(&jobs("3", Effort::Long), "chunk_minutes = 0.2") else { return };
    // The tasks wait until the edit is done.
    lab.cluster.slurm("scontrol", &["update", "partition=main", "state=down"]);
    lab.submit(&[]).succeeded();
    lab.folder.write("sweep.toml", jobs("[7, 8]", Effort::Short));
    lab.cluster.slurm("scontrol", &["update", "partition=main", "state=up"]);
    until("all chunks have finished", || lab.submissions()[0]["state"] == "finished");
    lab.jitai(&["status", "--merge"]).succeeded();
    lab.assert_as_on_one_machine();
}

#[test]
fn an_array_larger_than_max_array_size() {
    let profile = "chunk_minutes = 0.00001";
    let manifest = jobs("20", Effort::Trivial);
    let Some(lab) = Lab::with_arrays_of(8, &manifest, profile) else { return };
    let draft = lab.submit(&["--dry-run"]).succeeded().prints("#SBATCH --array=0-7\n");
    assert!(draft.stdout.contains("# 40 jobs in 8 chunks"), "{}", draft.stdout);
    assert!(!lab.folder.path("jitai.sqlite").exists(), "a dry run writes nothing");
    lab.finish();
    assert_eq!(lab.submissions()[0]["chunks"], 8);
}

/// A race of four settings in two rungs: 4 × 2 jobs and 3 of the agent without draws, then 2 × 2, then 3 of the winner.
const RACE: &str = r#"
format = 1
name = "race"
scenarios = ["P-H-D"]
environment.sigma = 0.6
environment.horizon = 10
evaluation.test_episodes = 20
search = { samples = 4, rungs = [2, 4], keep = 0.5, fresh = 3 }
[[agent]]
name = "drawn"
algorithm = "reinforce"
episodes = 200
layers = [4]
learning_rate = { log_uniform = [1e-6, 1e-2] }
[[agent]]
name = "declared"
algorithm = "reinforce"
episodes = 200
layers = [8]
"#;

#[test]
fn a_rung_of_a_race_is_a_submission() {
    let Some(lab) = Lab::with(RACE, "chunk_minutes = 0.01") else { return };
    let first = lab.submit(&[]).succeeded().prints("11 jobs in");
    let first = first.says("drawn: rung 1 of 2: 4 of 4 arms open; next, the best 2 go on");
    first.says("submit again when the tasks have ended");
    until("the first rung has ended", || lab.submissions()[0]["state"] == "finished");
    let second = lab.submit(&[]).succeeded().prints("4 jobs in");
    second.says("merged 11 runs").says("rung 2 of 2: 2 of 2 arms open");
    // It submits the fresh seeds, at once if the second rung has ended, and else after a wait.
    let last = lab.submit(&["--wait"]).succeeded();
    assert!([&last.stdout, &last.stderr].iter().any(|said| said.contains("3 jobs in")));
    last.says("has won\n").says("18 completed, 0 failed");
    let jobs = lab.submissions().iter().map(|one| one["jobs"].as_u64()).collect::<Vec<_>>();
    assert_eq!(jobs, [Some(11), Some(4), Some(3)]);
    lab.assert_as_on_one_machine();
}

#[test]
fn sbatch_absent() {
    let Some(lab) = Lab::with(&jobs("1", Effort::Trivial), "") else { return };
    // All other Slurm programs are present.
    let bin = lab.folder.path("few");
    fs::create_dir(&bin).unwrap();
    for program in ["scontrol", "squeue"] {
        std::os::unix::fs::symlink(format!("/usr/bin/{program}"), bin.join(program)).unwrap();
    }
    for path in [bin.as_path(), "/nowhere".as_ref()] {
        let mut command = lab.command(&["submit", "sweep.toml"]);
        command.env("PATH", path);
        crate::support::Running::of(command).wait().ended(3).says("a command of Slurm");
    }
    assert!(lab.submissions().is_empty());
}

#[test]
fn sbatch_refusing() {
    let Some(lab) = Lab::with(&jobs("1", Effort::Trivial), "partition = \"wrong\"") else { return };
    let refused = lab.submit(&[]).ended(3).says("`sbatch` failed: ");
    assert!(refused.stderr.contains("invalid partition specified"), "{}", refused.stderr);
    assert!(lab.submissions().is_empty(), "a refused array is no submission");
    lab.folder.write("cluster.toml", "engine = \"slurm\"\npartition = \"main\"\n");
    lab.finish();
}

#[test]
fn five_hundred_chunks_of_trivial_jobs() {
    let manifest = jobs("500", Effort::Trivial);
    let profile = "chunk_minutes = 0.00001";
    let Some(lab) = Lab::with_arrays_of(500, &manifest, profile) else { return };
    lab.submit(&[]).succeeded().prints("1000 jobs in 500 chunks");
    lab.finish();
    assert_eq!(lab.submissions()[0]["finished"], 500);
}
