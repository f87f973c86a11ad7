//! Output that is not read to its end, or that cannot be written.

use std::fs::OpenOptions;
use std::io::{BufRead, BufReader};
use std::process::Stdio;

use crate::failures::partly_diverging;
use crate::support::{Effort, Folder, manifest};

fn completed() -> Folder {
    Folder::completed(&manifest("sweep", "0.6", "2", Effort::Trivial))
}

/// Reads `lines` lines of the output, as `head` does, and closes the pipe; returns the exit code.
#[track_caller]
fn head(folder: &Folder, lines: usize, arguments: &[&str]) -> Option<i32> {
    let mut child = folder
        .command(arguments.iter().copied())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let output = BufReader::new(child.stdout.take().unwrap());
    let read = output.lines().take(lines).map(Result::unwrap).count();
    assert_eq!(read, lines, "{arguments:?}");
    let ended = child.wait_with_output().unwrap();
    let stderr = String::from_utf8(ended.stderr).unwrap();
    assert!(!stderr.contains("panicked") && !stderr.contains("error"), "{stderr}");
    ended.status.code()
}

#[test]
fn a_reader_that_has_read_enough_is_no_error() {
    let folder = completed();
    folder.write("other.toml", manifest("other", "0.6", "2", Effort::Trivial));
    let endless = "WITH RECURSIVE n (i) AS (VALUES (1) UNION ALL SELECT i + 1 FROM n) \
                   SELECT i FROM n LIMIT 1000000";
    for arguments in [
        &["query", endless, "--format", "csv"][..],
        &["query", endless, "--format", "json"],
        &["query", "SELECT * FROM parameter AS a, parameter AS b"],
        &["simulate", "--episodes", "2000", "--format", "csv"],
        &["simulate", "--episodes", "2000"],
        &["status"],
        &["plan", "sweep.toml", "--jobs"],
        &["plan", "sweep.toml", "--resolved"],
        &["check", "sweep.toml", "other.toml"],
        &["schema"],
        &["--help"],
    ] {
        assert_eq!(head(&folder, 1, arguments), Some(0), "{arguments:?}");
        assert_eq!(head(&folder, 0, arguments), Some(0), "{arguments:?}");
    }
}

#[test]
fn a_sweep_whose_output_nobody_reads_ends_as_it_would() {
    for format in ["text", "json"] {
        let folder = Folder::with(&manifest("sweep", "0.6", "2", Effort::Short));
        assert_eq!(head(&folder, 0, &["run", "sweep.toml", "--format", format]), Some(0));
        let completed = "SELECT count(*) FROM run WHERE status = 'completed'";
        assert_eq!(folder.number(completed), 4, "{format}");
    }
}

#[test]
fn a_sweep_whose_output_nobody_reads_still_reports_failures() {
    for format in ["text", "json"] {
        let folder = Folder::with(&partly_diverging());
        assert_eq!(head(&folder, 0, &["run", "sweep.toml", "--format", format]), Some(1));
    }
}

#[test]
fn a_check_whose_output_nobody_reads_still_reports_faults() {
    let folder = Folder::with(&manifest("sweep", "0.6", "2", Effort::Trivial));
    folder.write("faulty.toml", manifest("faulty", "-0.6", "2", Effort::Trivial));
    let mut check = folder.command(["check", "sweep.toml", "faulty.toml"]);
    let mut child = check.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    drop(child.stdout.take());
    let ended = child.wait_with_output().unwrap();
    let stderr = String::from_utf8(ended.stderr).unwrap();
    assert_eq!(ended.status.code(), Some(2), "{stderr}");
    assert!(stderr.contains("faulty.toml"), "{stderr}");
}

#[cfg(target_os = "linux")]
#[test]
fn output_that_cannot_be_written_is_an_error() {
    let folder = completed();
    for arguments in [
        &["query", "SELECT * FROM evaluation_episode"][..],
        &["query", "SELECT 1", "--format", "csv"],
        &["query", "SELECT 1", "--format", "json"],
        &["plan", "sweep.toml", "--resolved"],
        &["status"],
        &["schema"],
        &["simulate"],
        &["run", "sweep.toml"],
    ] {
        let full = OpenOptions::new().write(true).open("/dev/full").unwrap();
        let output = folder.command(arguments.iter().copied()).stdout(full).output().unwrap();
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(3), "{arguments:?}: {stderr}");
        assert!(stderr.contains("No space left on device"), "{arguments:?}: {stderr}");
    }
}
