//! Tasks that are stopped and resume.

use super::cluster::{Lab, signal, until};
use crate::support::{Effort, manifest};

/// Two jobs per seed, one of which trains this many episodes, at about 500 to 800 episodes per second.
fn long_jobs(seeds: &str, episodes: u32) -> String {
    manifest("stopped", "0.6", seeds, Effort::Long)
        .replace("episodes = 4000\n", &format!("episodes = {episodes}\n"))
}

#[test]
fn the_time_limit_reached() {
    // The signal arrives between five and about forty seconds after the start.
    let profile = "chunk_minutes = 1000\ntime_limit = 1\nsignal = \"B:TERM@55\"";
    let Some(lab) = Lab::with(&long_jobs("1", 36_000), profile) else { return };
    lab.submit(&["--wait"]).succeeded();
    let attempts = lab.attempts();
    assert!(attempts.len() > 1, "{attempts:#?}");
    assert_eq!(attempts[0]["end"], "stopped");
    assert!(lab.logs().contains("resumed from episode"), "{}", lab.logs());
    assert_eq!(lab.submissions().len(), 1, "the cluster itself runs it again");
    lab.assert_as_on_one_machine();
}

#[test]
fn the_time_limit_reached_by_three_tasks() {
    let Some(lab) = Lab::waiting("time_limit = 1\nsignal = \"B:TERM@55\"") else { return };
    lab.submit(&[]).succeeded().prints("3 jobs in 3 chunks");
    lab.until_all_run();
    until("all tasks have stopped", || lab.ends().iter().all(|ends| *ends == ["stopped"]));
    lab.folder.write("go", "");
    lab.finish();
    // Each task was queued again by itself, and no task a second time because of another.
    assert_eq!(lab.ends(), vec![["stopped", "finished"]; 3]);
    assert_eq!(lab.submissions().len(), 1, "the cluster itself runs them again");
}

#[test]
fn a_warning_to_the_task_with_the_id_of_the_array_after_the_others_completed() {
    let Some(lab) = Lab::waiting("") else { return };
    lab.submit(&[]).succeeded();
    let leader = lab.until_all_run();
    // The file lets all programs end, except the one that is stopped.
    let program = lab.program_of(leader);
    signal(program, "STOP");
    lab.folder.write("go", "");
    until("the others have finished", || lab.submissions()[0]["finished"] == 2);
    std::fs::remove_file(lab.folder.path("go")).unwrap();
    signal(program, "CONT");
    let task = format!("{}_{leader}", lab.array());
    lab.cluster.slurm("scancel", &["--batch", "--signal=TERM", &task]);
    let leader = usize::try_from(leader).unwrap();
    until("the task has stopped", || lab.ends()[leader] == ["stopped"]);
    lab.folder.write("go", "");
    lab.finish();
    let ends = lab.ends();
    assert_eq!(ends.iter().map(Vec::len).sum::<usize>(), 4, "{ends:?}");
    assert_eq!(ends[leader], ["stopped", "finished"]);
}

#[test]
fn preempted_by_scontrol_requeue() {
    let Some(lab) = Lab::in_three_chunks(&long_jobs("3", 1_500), "") else { return };
    lab.submit(&[]).succeeded();
    let leader = lab.until_all_run();
    lab.cluster.slurm("scontrol", &["requeue", &format!("{}_{leader}", lab.array())]);
    let leader = usize::try_from(leader).unwrap();
    until("the task has stopped", || lab.ends()[leader] == ["stopped"]);
    let shown = &lab.submissions()[0];
    assert_eq!((&shown["state"], &shown["lost"]), (&"open".into(), &0.into()), "{shown}");
    // No job is submitted a second time.
    lab.submit(&[]).succeeded().prints("nothing to submit").says(" held by the cluster");
    lab.finish();
    let ends = lab.ends();
    assert_eq!(ends.iter().map(Vec::len).sum::<usize>(), 4, "{ends:?}");
    assert!(lab.logs().contains("resumed from episode"), "{}", lab.logs());
}

#[test]
fn cancelled_and_submitted_again() {
    let Some(lab) = Lab::in_three_chunks(&long_jobs("3", 1_500), "") else { return };
    lab.submit(&[]).succeeded();
    lab.until_all_run();
    lab.jitai(&["cancel"]).succeeded().prints("cancelled ");
    until("the cluster holds nothing", || {
        lab.cluster.slurm("squeue", &["--noheader"]).trim().is_empty()
    });
    assert_eq!(lab.ends(), vec![["stopped"]; 3]);
    assert_eq!(lab.submissions()[0]["state"], "cancelled");
    lab.jitai(&["cancel"]).succeeded().says("nothing to cancel");
    lab.finish();
    assert_eq!(lab.submissions().len(), 2);
    assert!(lab.logs().contains("resumed from episode"), "{}", lab.logs());
}
