//! Stores under other names: symbolic links lead to the one store with everything that lies beside it, and a
//! file with two names, which could have two write-ahead logs, is rejected.

use std::collections::HashSet;
use std::fs;
use std::os::unix::fs::symlink;
use std::path::PathBuf;
use std::process::Command;

use rusqlite::{Connection, OpenFlags};

use crate::support::{Effort, Finished, Folder, assert_same_rows, left_out, manifest, until};

const COMPLETED: &str = "SELECT count(*) AS n FROM run_summary WHERE status = 'completed'";

/// A folder whose store `real/s.sqlite` was left by a killed process, with completed runs in its log.
/// `links/s.sqlite` leads to the store through another link and a linked folder.
fn killed() -> (Folder, i64) {
    let folder = Folder::with(&manifest("sweep", "0.6", "400", Effort::Trivial));
    for name in ["real", "links"] {
        fs::create_dir(folder.path(name)).unwrap();
    }
    symlink("real", folder.path("folder")).unwrap();
    symlink("../folder/s.sqlite", folder.path("links/next.sqlite")).unwrap();
    symlink("next.sqlite", folder.path("links/s.sqlite")).unwrap();
    let run = folder.start(["run", "sweep.toml", "--store", "links/s.sqlite", "--workers", "1"]);
    until("runs are stored", || count(&folder, "real/s.sqlite").unwrap_or(0) > 5);
    run.kill();
    assert!(fs::metadata(folder.path("real/s.sqlite-wal")).unwrap().len() > 0);
    let completed = count(&folder, "real/s.sqlite").unwrap();
    (folder, completed)
}

/// The number of completed runs, read without the program.
fn count(folder: &Folder, store: &str) -> Option<i64> {
    let store =
        Connection::open_with_flags(folder.path(store), OpenFlags::SQLITE_OPEN_READ_ONLY).ok()?;
    store.query_row(COMPLETED, [], |row| row.get(0)).ok()
}

/// The names of everything in a folder.
fn names(folder: &Folder, name: &str) -> Vec<String> {
    let entries = fs::read_dir(folder.path(name)).unwrap();
    let mut names: Vec<String> =
        entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn every_command_reads_a_store_behind_links_with_its_log() {
    let (folder, completed) = killed();
    // Nobody may write to the store, so a reader takes no lock and makes no file beside it.
    let store = folder.path("real/s.sqlite");
    let mut permissions = fs::metadata(&store).unwrap().permissions();
    permissions.set_readonly(true);
    fs::set_permissions(&store, permissions).unwrap();
    for store in ["real/s.sqlite", "folder/s.sqlite", "links/next.sqlite", "links/s.sqlite"] {
        let jitai = |arguments: &[&str]| -> Finished {
            folder.jitai(arguments.iter().copied().chain(["--store", store])).succeeded()
        };
        let answer = jitai(&["query", COMPLETED, "--format", "json"]).json();
        assert_eq!(answer[0]["n"], completed, "{store}");
        let status = jitai(&["status", "--format", "json"]).json();
        assert_eq!(status[0]["completed"], completed, "{store}");
        let plan = jitai(&["plan", "sweep.toml", "--format", "json"]).json();
        assert_eq!(plan[0]["completed"], completed, "{store}");
        jitai(&["export", "--out", "export"]);
        let runs = folder.read("export/run_summary.csv");
        let in_export = runs.lines().filter(|line| line.contains(",completed,")).count();
        assert_eq!(in_export as i64, completed, "{store}");
        jitai(&["report", "sweep.toml", "--out", "report"]);
        jitai(&["doctor"]).prints(&format!("is healthy: {completed} completed runs"));
        let into = format!("merged-{}", store.replace('/', "-"));
        let merged = folder.jitai(["merge", store, "--store", &into, "--format", "json"]);
        assert_eq!(merged.succeeded().json()["completed"], completed, "{store}");
        let new = format!("salvaged-{}", store.replace('/', "-"));
        jitai(&["doctor", "--salvage", &new]).prints(&format!("{completed} completed runs"));
    }
    assert_eq!(names(&folder, "links"), ["next.sqlite", "s.sqlite"]);
}

#[test]
fn a_store_behind_a_link_has_its_marks_checkpoints_and_backups_beside_the_file() {
    let folder = Folder::with(&manifest("sweep", "0.6", "1", Effort::Endless));
    fs::create_dir(folder.path("real")).unwrap();
    fs::create_dir(folder.path("elsewhere")).unwrap();
    symlink("real/jitai.sqlite", folder.path("jitai.sqlite")).unwrap();
    // A link to a folder that does not exist yet.
    let checkpoints = folder.path("real/jitai.sqlite.checkpoints");
    symlink("../elsewhere/checkpoints", &checkpoints).unwrap();
    let run = ["run", "sweep.toml", "--workers", "2"];
    let with_checkpoints = [run.as_slice(), &["--checkpoint-every", "0.05"]].concat();
    for aborts in 1..=5 {
        let sweep = folder.start(if aborts == 1 { with_checkpoints.clone() } else { run.to_vec() });
        let running =
            format!("SELECT count(*) FROM run WHERE status = 'running' AND session = {aborts}");
        // After checkpoints, an abort makes no suspects; after the second one, both run alone by turns.
        let jobs = if aborts <= 2 { 2 } else { 1 };
        until("jobs run", || folder.count_if_there(&running) == Some(jobs));
        assert!(names(&folder, "real").contains(&format!("jitai.sqlite-session-{aborts}")));
        until("both jobs have a checkpoint", || {
            let all = checkpoints.exists().then(|| names(&folder, "elsewhere/checkpoints"));
            let whole = all.iter().flatten().filter(|name| name.ends_with(".1.checkpoint"));
            let jobs = whole.filter_map(|name| name.split('.').next());
            jobs.collect::<HashSet<_>>().len() == 2
        });
        sweep.signal("ABRT");
        assert_eq!(sweep.wait().code, None);
    }
    // The third abort of the first job without a checkpoint was in isolation, so the job has failed.
    let sweep = folder.start(run);
    until("a job has crashed", || {
        folder.count_if_there("SELECT count(*) FROM run WHERE failure_kind = 'crashed'") == Some(1)
    });
    sweep.signal("INT");
    sweep.wait().ended(130);
    let left = names(&folder, "real");
    assert!(left.iter().all(|name| !name.contains("-session-")), "{left:?}");
    let beside: Vec<String> =
        names(&folder, "").into_iter().filter(|name| name.starts_with("jitai.sqlite")).collect();
    assert_eq!(beside, ["jitai.sqlite"]);

    let old = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/data/stores/v1-0.1.0.sqlite");
    fs::copy(old, folder.path("real/old.sqlite")).unwrap();
    symlink("real/old.sqlite", folder.path("old.sqlite")).unwrap();
    folder.jitai(["merge", "jitai.sqlite", "--store", "old.sqlite"]).succeeded();
    assert!(folder.path("real/old.sqlite.v1.bak").exists());
}

#[test]
fn a_link_to_a_missing_store_is_where_the_store_is_made() {
    let text = manifest("sweep", "0.6", "2", Effort::Trivial);
    let folder = Folder::with(&text);
    fs::create_dir(folder.path("real")).unwrap();
    symlink("real/later.sqlite", folder.path("jitai.sqlite")).unwrap();
    folder.jitai(["status"]).ended(3).says("there is no store at `").says("real/later.sqlite`");
    folder.jitai(["run", "sweep.toml", "--quiet"]).succeeded();
    assert_eq!(names(&folder, "real"), ["later.sqlite"]);
    assert_same_rows(&folder.dump(), &Folder::completed(&text).dump());
    symlink("gone/s.sqlite", folder.path("lost.sqlite")).unwrap();
    let run = ["run", "sweep.toml", "--store", "lost.sqlite"];
    folder.jitai(run).ended(3).says("there is no folder `").says("gone`");
    symlink("circle.sqlite", folder.path("circle.sqlite")).unwrap();
    folder.jitai(["status", "--store", "circle.sqlite"]).ended(3).says("levels of symbolic links");
}

#[test]
fn a_link_to_nothing_in_a_merged_folder_ends_the_merge() {
    let folder = Folder::completed(&manifest("sweep", "0.6", "1", Effort::Trivial));
    fs::create_dir(folder.path("parts")).unwrap();
    fs::rename(folder.path("jitai.sqlite"), folder.path("parts/1.sqlite")).unwrap();
    symlink("/gone/2.sqlite", folder.path("parts/2.sqlite")).unwrap();
    folder
        .jitai(["merge", "parts"])
        .ended(3)
        .says(
            "cannot merge `parts/2.sqlite`: it is a link to `/gone/2.sqlite`, which does not exist",
        )
        .says("nothing was merged");
    assert!(!folder.path("jitai.sqlite").exists());
    // A link to another store of the folder adds nothing.
    fs::remove_file(folder.path("parts/2.sqlite")).unwrap();
    symlink("1.sqlite", folder.path("parts/2.sqlite")).unwrap();
    folder.jitai(["merge", "parts"]).succeeded().prints("copied from 1 store");
}

/// Every command that opens a store, with `other.sqlite` as the source or target of a merge.
fn every_command(store: &str) -> Vec<Vec<&str>> {
    let commands: [&[&str]; 11] = [
        &["run", "sweep.toml"],
        &["status"],
        &["plan", "sweep.toml"],
        &["query", COMPLETED],
        &["export", "--out", "out"],
        &["report", "sweep.toml", "--out", "out"],
        &["doctor"],
        &["doctor", "--salvage", "saved.sqlite"],
        &["forget", "sweep", "--yes"],
        &["merge", "other.sqlite"],
        &["cancel"],
    ];
    let mut commands: Vec<Vec<&str>> =
        commands.iter().map(|command| [command, &["--store", store][..]].concat()).collect();
    commands.push(vec!["merge", store, "--store", "other.sqlite"]);
    commands
}

/// A folder with a completed store at `name` and another one.
fn two_stores(name: &str) -> Folder {
    let folder = Folder::completed(&manifest("sweep", "0.6", "2", Effort::Trivial));
    fs::copy(folder.path("jitai.sqlite"), folder.path("other.sqlite")).unwrap();
    fs::rename(folder.path("jitai.sqlite"), folder.path(name)).unwrap();
    folder
}

#[test]
fn a_store_with_a_second_hard_link_is_refused_by_every_command() {
    let folder = two_stores("one.sqlite");
    fs::hard_link(folder.path("one.sqlite"), folder.path("two.sqlite")).unwrap();
    symlink("two.sqlite", folder.path("link.sqlite")).unwrap();
    let before = fs::read(folder.path("one.sqlite")).unwrap();
    for store in ["one.sqlite", "two.sqlite", "link.sqlite"] {
        for command in every_command(store) {
            folder.jitai(command).ended(3).says("has 2 names (hard links)");
        }
    }
    assert!(fs::read(folder.path("one.sqlite")).unwrap() == before);
    assert!(!folder.path("saved.sqlite").exists());
    fs::remove_file(folder.path("one.sqlite")).unwrap();
    for command in every_command("two.sqlite") {
        folder.jitai(command).succeeded();
    }
}

#[test]
fn a_sealed_copy_may_have_many_names_and_is_only_read() {
    let folder = two_stores("one.sqlite");
    let copy = format!("VACUUM INTO '{}'", folder.path("sealed.sqlite").display());
    Connection::open(folder.path("one.sqlite")).unwrap().execute_batch(&copy).unwrap();
    fs::hard_link(folder.path("sealed.sqlite"), folder.path("again.sqlite")).unwrap();
    for store in ["sealed.sqlite", "again.sqlite"] {
        let query = ["query", COMPLETED, "--format", "csv", "--store", store];
        assert_eq!(folder.jitai(query).succeeded().stdout, "n\n4\n");
        let into = format!("merged-{store}");
        let merge = ["merge", store, "--store", &into];
        folder.jitai(merge).succeeded().prints("4 completed runs");
        let run = ["run", "sweep.toml", "--store", store];
        folder.jitai(run).ended(3).says("has 2 names (hard links)");
    }
}

#[test]
fn a_hard_link_made_while_a_sweep_runs_does_not_disturb_the_sweep_and_nobody_reads_half_of_it() {
    let text = manifest("sweep", "0.6", "10", Effort::Short);
    let folder = Folder::with(&text);
    let mut sweep = folder.start(["run", "sweep.toml", "--workers", "1"]);
    until("runs are stored", || folder.count_if_there(COMPLETED) > Some(3));
    fs::hard_link(folder.path("jitai.sqlite"), folder.path("copy.sqlite")).unwrap();
    for store in ["jitai.sqlite", "copy.sqlite"] {
        let query = ["query", COMPLETED, "--store", store];
        folder.jitai(query).ended(3).says("has 2 names (hard links)");
        folder.jitai(["merge", store, "--store", "m.sqlite"]).ended(3).says("2 names");
    }
    assert!(!sweep.has_ended());
    sweep.wait().succeeded();
    fs::remove_file(folder.path("copy.sqlite")).unwrap();
    assert_same_rows(&folder.dump(), &Folder::completed(&text).dump());
}

/// A file that is mounted on a file; unmounted at the end.
struct Mounted(PathBuf);

impl Mounted {
    /// `None`, as a part left out, if this process must not mount.
    fn on(original: PathBuf, place: PathBuf) -> Option<Mounted> {
        fs::write(&place, "").unwrap();
        let mount = Command::new("mount").arg("--bind").arg(original).arg(&place).output();
        if mount.as_ref().is_ok_and(|output| output.status.success()) {
            return Some(Mounted(place));
        }
        left_out("a store mounted as a single file", &format!("{mount:?}"));
        None
    }
}

impl Drop for Mounted {
    fn drop(&mut self) {
        // A mount that remains is visible to the user.
        let _ = Command::new("umount").arg(&self.0).status();
    }
}

#[test]
fn a_store_that_is_mounted_as_a_single_file_is_refused_by_every_command() {
    let folder = two_stores("one.sqlite");
    symlink("two.sqlite", folder.path("link.sqlite")).unwrap();
    let Some(_mounted) = Mounted::on(folder.path("one.sqlite"), folder.path("two.sqlite")) else {
        return;
    };
    for store in ["two.sqlite", "link.sqlite"] {
        for command in every_command(store) {
            folder.jitai(command).ended(3).says("is mounted as a single file");
        }
    }
    // Its first name is the one with the log.
    folder.jitai(["run", "sweep.toml", "--store", "one.sqlite"]).succeeded();
}
