//! Tasks that die.

use std::fs;
use std::thread;
use std::time::Duration;

use super::cluster::{Lab, has_ended, parent, signal, until};
use crate::support::{Effort, manifest};

/// Tasks hand in every two seconds.
const OFTEN: &str = "hand_in_minutes = 0.03";

/// Four jobs for each of three chunks.
fn twelve_jobs() -> String {
    manifest("lost", "0.6", "6", Effort::Long)
        .replace("episodes = 4000\n", "episodes = 1500\n")
        .replace("episodes = 120000\n", "episodes = 60000\n")
}

#[test]
fn a_node_killed_in_mid_chunk() {
    let Some(lab) = Lab::in_three_chunks(&twelve_jobs(), OFTEN) else { return };
    lab.submit(&[]).succeeded().prints("12 jobs in 3 chunks");
    let node = lab.until_running();
    until("a part is handed in", || !lab.parts().is_empty());
    lab.cluster.kill_node(&node);
    lab.finish();
    let attempts = lab.attempts();
    assert!(attempts.len() > 3 || lab.submissions().len() > 1, "{attempts:?}");
}

#[test]
fn a_task_killed_by_sigkill() {
    let Some(lab) = Lab::in_three_chunks(&twelve_jobs(), OFTEN) else { return };
    lab.submit(&[]).succeeded();
    lab.until_running();
    until("a part is handed in", || !lab.parts().is_empty());
    let (task, _) = lab.task_process().expect("four jobs take longer than the first hand-in");
    signal(task, "KILL");
    until("the cluster no longer holds the task", || lab.submissions()[0]["lost"] == 1);
    let shown = lab.jitai(&["status"]).succeeded().says("its task died; log: ").prints("lost");
    assert!(!shown.stdout.contains("finished 1"), "{}", shown.stdout);
    assert!(lab.logs().contains("the task was killed by signal 9"), "{}", lab.logs());
    lab.finish();
    // A piece has one job. The cluster permits three tasks, so a fourth piece waits for the next submission.
    let again = lab.submissions().split_off(1);
    let number = |of: &str| -> Vec<u64> {
        again.iter().map(|submission| submission[of].as_u64().unwrap()).collect()
    };
    let jobs = number("jobs");
    assert!(matches!(jobs[..], [1..=3] | [3, 1]), "only the jobs of the killed task: {again:#?}");
    assert_eq!(number("chunks"), jobs, "in pieces");
}

#[test]
fn a_frozen_task_that_wakes_up_after_its_replacement_has_handed_in() {
    // Each task has a node of its own.
    let Some(lab) = Lab::in_three_chunks(&twelve_jobs(), "exclusive = true") else { return };
    lab.submit(&[]).succeeded();
    lab.until_all_run();
    // The node freezes: its first process, the ancestor of all others, is stopped first.
    let (task, chunk) = lab.task_process().unwrap();
    let named = format!("--jobs={}_{chunk}", lab.array());
    let node = lab.cluster.slurm("squeue", &["--noheader", &named, "--format=%N"]);
    let node = node.trim().to_owned();
    let script = parent(task);
    let step = parent(script);
    let daemon = lab.node_daemon(&node);
    let first = parent(daemon);
    signal(first, "STOP");
    // Slurm on the node is killed, so that it cannot end the task when the task wakes up. The task is
    // stopped only after this: a stopped process whose group loses its parent gets a SIGHUP and wakes
    // up.
    for process in [step, daemon] {
        signal(process, "KILL");
    }
    until("Slurm on the node is gone", || has_ended(step) && has_ended(daemon));
    for process in [script, task] {
        signal(process, "STOP");
    }
    lab.cluster.down(&node);
    lab.finish();
    assert_eq!((lab.parts().len(), lab.parts_of(chunk).len()), (3, 1));
    for process in [script, task] {
        signal(process, "CONT");
    }
    until("the frozen task hands in", || lab.parts_of(chunk).len() == 2);
    let lists: Vec<String> = lab
        .parts_of(chunk)
        .iter()
        .map(|part| {
            let list = fs::read_to_string(part.with_extension("jobs")).unwrap();
            let mut lines: Vec<&str> = list.lines().collect();
            lines.sort_unstable();
            lines.join("\n")
        })
        .collect();
    assert_eq!(lists[0], lists[1], "two parts with the same jobs");
    until("the frozen task says that it has finished", || {
        lab.attempts().iter().all(|attempt| attempt["end"] == "finished")
    });
    let status = lab.jitai(&["status", "--merge"]).succeeded();
    assert!(!status.stderr.contains("conflict"), "{}", status.stderr);
    lab.assert_as_on_one_machine();
}

#[test]
fn a_job_that_brings_its_task_down_three_times_has_failed_and_the_others_continue() {
    let short = manifest("killers", "0.6", "2", Effort::Short);
    let endless = short.replacen("seeds = 2", "seeds = [1, 2]", 1)
        + "[[agent]]\nname = \"killer\"\nalgorithm = \"reinforce\"\nepisodes = 9000000\n\
           layers = [64]\n[[exclude]]\nagent.name = \"killer\"\nseed = 2\n";
    let Some(lab) = Lab::with(&endless, "chunk_minutes = 100000") else { return };
    let listed =
        lab.jitai(&["plan", "sweep.toml", "--jobs", "--format", "json"]).succeeded().json();
    let is_killer = |job: &&serde_json::Value| job["agent"] == "killer";
    let key = listed.as_array().unwrap().iter().find(is_killer).unwrap()["job_key"].clone();
    let key = key.as_str().unwrap().to_owned();
    let mut waiting = lab.start(&["submit", "sweep.toml", "--cluster", "cluster.toml", "--wait"]);
    let mut killed = 0;
    until("the submission ends", || {
        if let Some(task) = lab.task_process_with(&key) {
            signal(task, "KILL");
            killed += 1;
            thread::sleep(Duration::from_millis(500));
        }
        waiting.has_ended()
    });
    waiting.wait().ended(1).says("failed (crashed): three tasks died while running it");
    assert_eq!(killed, 3);
    assert_eq!(lab.folder.number("SELECT count(*) FROM run WHERE status = 'completed'"), 4);
    let crashed = "SELECT count(*) FROM run WHERE failure_kind = 'crashed'";
    assert_eq!(lab.folder.number(crashed), 1);
    lab.submit(&[]).succeeded().prints("nothing to submit");
}
