//! Tasks that are stopped and resume.

use crate::cluster::{Lab, until};
use crate::support::{Effort, manifest};

/// Two jobs, one of which trains this many episodes, at about 500 to 800 episodes per second.
fn long_jobs(episodes: u32) -> String {
    manifest("stopped", "0.6", "1", Effort::Long)
        .replace("episodes = 4000\n", &format!("episodes = {episodes}\n"))
}

#[test]
fn the_time_limit_reached() {
    // The signal arrives between five and about forty seconds after the start.
    let profile = "chunk_minutes = 1000\ntime_limit = 1\nsignal = \"B:TERM@55\"";
    let Some(lab) = Lab::with(&long_jobs(36_000), profile) else { return };
    lab.submit(&["--wait"]).succeeded();
    let attempts = lab.attempts();
    assert!(attempts.len() > 1, "{attempts:#?}");
    assert_eq!(attempts[0]["end"], "stopped");
    assert!(lab.logs().contains("resumed from episode"), "{}", lab.logs());
    assert_eq!(lab.submissions().len(), 1, "the cluster itself runs it again");
    lab.assert_as_on_one_machine();
}

#[test]
fn preempted_by_scontrol_requeue() {
    let Some(lab) = Lab::with(&long_jobs(3_000), "chunk_minutes = 1000") else { return };
    lab.submit(&[]).succeeded();
    lab.until_running();
    let array = std::fs::read_to_string(lab.submission().join("array")).unwrap();
    lab.cluster.slurm("scontrol", &["requeue", &format!("{}_0", array.trim())]);
    until("the task has stopped", || lab.attempts()[0]["end"] == "stopped");
    let shown = &lab.submissions()[0];
    assert_eq!((&shown["state"], &shown["finished"]), (&"open".into(), &0.into()), "{shown}");
    assert_eq!(shown["done"], 0);
    // No job is submitted a second time.
    lab.submit(&[]).succeeded().prints("nothing to submit").says("2 held by the cluster");
    lab.finish();
    assert_eq!(lab.attempts().len(), 2, "{:#?}", lab.attempts());
    assert!(lab.logs().contains("resumed from episode"), "{}", lab.logs());
}

#[test]
fn cancelled_and_submitted_again() {
    let Some(lab) = Lab::with(&long_jobs(3_000), "chunk_minutes = 1000") else { return };
    lab.submit(&[]).succeeded();
    lab.until_running();
    lab.jitai(&["cancel"]).succeeded().prints("cancelled ");
    until("the cluster holds nothing", || {
        lab.cluster.slurm("squeue", &["--noheader"]).trim().is_empty()
    });
    assert_eq!(lab.attempts()[0]["end"], "stopped");
    assert_eq!(lab.submissions()[0]["state"], "cancelled");
    lab.jitai(&["cancel"]).succeeded().says("nothing to cancel");
    lab.finish();
    assert_eq!(lab.submissions().len(), 2);
    assert!(lab.logs().contains("resumed from episode"), "{}", lab.logs());
}
