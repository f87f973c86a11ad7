//! A memory limit of a control group: a job that cannot fit is refused, a job that the kernel kills again
//! and again has failed, and the other jobs complete.
//!
//! As root, where control groups are mounted. A target of its own: the kernel counts these kills for the whole
//! system, and another test that kills processes would take its kills for them.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{ExitStatus, Stdio};

use crate::support::{Folder, left_out};

/// A control group with a memory limit; removed at the end.
struct Group(PathBuf);

impl Group {
    /// A group with this limit; `None`, as a part left out, where this process may not make one.
    fn with_megabytes(megabytes: u64) -> Option<Group> {
        let name = format!("jitai-test-{}-{megabytes}", std::process::id());
        let places =
            [("/sys/fs/cgroup/memory", "memory.limit_in_bytes"), ("/sys/fs/cgroup", "memory.max")];
        for (hierarchy, file) in places {
            let group = Group(Path::new(hierarchy).join(&name));
            let limit = (megabytes << 20).to_string();
            // In the unified hierarchy, the parent has to hand memory on to its groups.
            let _ = fs::write(Path::new(hierarchy).join("cgroup.subtree_control"), "+memory");
            if fs::create_dir(&group.0).is_ok() && fs::write(group.0.join(file), limit).is_ok() {
                let _ = fs::write(group.0.join("memory.swap.max"), "0");
                return Some(group);
            }
        }
        left_out("memory limits", "no control group with such a limit can be made");
        None
    }

    /// Runs the sweep of a folder in the group.
    fn run(&self, folder: &Folder, more: &str) -> ExitStatus {
        let (processes, program) = (self.0.join("cgroup.procs"), env!("CARGO_BIN_EXE_jitai"));
        let script = format!(
            "echo $$ >{} && exec {program} run sweep.toml --quiet {more}",
            processes.display()
        );
        let mut shell = folder.command_of("sh", ["-c", &script]);
        shell.stdout(Stdio::null()).stderr(Stdio::null()).status().unwrap()
    }
}

impl Drop for Group {
    fn drop(&mut self) {
        // The group is empty; another process that reads it may delay its removal.
        let _ = fs::remove_dir(&self.0);
    }
}

/// Two seeds of a DQN with two hidden layers of this width, and of a rule behind it.
fn manifest(width: u32) -> String {
    format!(
        "format = 1
name = \"sweep\"
scenarios = \"P-H-D\"
seeds = 2
environment.sigma = 0.4
evaluation.test_episodes = 20
[[agent]]
name = \"huge\"
algorithm = \"dueling_dqn\"
layers = [{width}, {width}]
episodes = 20
[[agent]]
name = \"small\"
algorithm = \"rule\"
rule = \"never\"
"
    )
}

fn count(folder: &Folder, condition: &str) -> i64 {
    folder.number(&format!("SELECT count(*) FROM run_summary WHERE {condition}"))
}

#[test]
fn a_network_that_exceeds_the_limit_is_refused_and_the_others_complete() {
    let Some(group) = Group::with_megabytes(120) else { return };
    // Six copies of 16 million weights take 384 MB.
    let folder = Folder::with(&manifest(4000));
    assert_eq!(group.run(&folder, "--workers 1").code(), Some(1));
    assert_eq!(count(&folder, "agent = 'huge' AND failure_kind = 'out_of_memory'"), 2);
    assert_eq!(count(&folder, "agent = 'small' AND status = 'completed'"), 2);
    assert_eq!(folder.runs(), 4);
}

#[test]
fn jobs_that_the_kernel_kills_come_last_and_fail_and_the_others_complete() {
    for workers in [1, 2] {
        let Some(group) = Group::with_megabytes(24 + workers) else { return };
        // Six copies of a million weights take 23 MB, within the limit; the whole program takes 68 MB.
        let folder = Folder::with(&manifest(1000));
        let (mut kills, mut completed) = (0, Vec::new());
        let ended = loop {
            let ended = group.run(&folder, &format!("--workers {workers}"));
            completed.push(count(&folder, "status = 'completed'"));
            if ended.code().is_some() {
                break ended;
            }
            kills += 1;
            assert!(kills < 12, "{completed:?}");
        };
        assert_eq!(ended.code(), Some(1));
        // After at most one death of each huge job, the others are done.
        assert_eq!((completed[2], kills), (2, if workers == 1 { 6 } else { 5 }), "{completed:?}");
        assert_eq!(count(&folder, "agent = 'huge' AND failure_kind = 'crashed'"), 2);
        folder.jitai(["doctor"]).succeeded();
    }
}
