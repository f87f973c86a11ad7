//! Hands the git revision to the program, for the provenance of runs.

use std::path::Path;
use std::process::Command;

fn git(arguments: &[&str]) -> Option<String> {
    let output = Command::new("git").args(arguments).output().ok()?;
    output.status.success().then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
}

fn main() {
    // A package inside somebody else's repository would report their revision.
    let own = Path::new(".git").exists();
    let revision = own.then(|| git(&["rev-parse", "--short=12", "HEAD"])).flatten();
    let revision = revision.map(|revision| {
        let dirty = git(&["--no-optional-locks", "status", "--porcelain", "--untracked-files=no"]);
        if dirty.is_some_and(|files| !files.is_empty()) {
            format!("{revision}-dirty")
        } else {
            revision
        }
    });
    println!("cargo::rustc-env=JITAI_GIT_REVISION={}", revision.as_deref().unwrap_or("unknown"));
    // The log of HEAD changes with every commit and checkout, and with nothing else.
    let log = own.then(|| git(&["rev-parse", "--git-path", "logs/HEAD"])).flatten();
    for path in ["src", "migrations", "Cargo.lock"].into_iter().chain(log.as_deref()) {
        println!("cargo::rerun-if-changed={path}");
    }
}
