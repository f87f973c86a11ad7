//! Several programs on one store at the same time: sweeps that share the work, and readers.

use rusqlite::{Connection, OpenFlags};

use crate::support::{Effort, Folder, assert_same_rows, manifest, until};

#[test]
fn two_sweeps_on_one_store_share_the_jobs() {
    let text = manifest("sweep", "[0.4, 0.6]", "4", Effort::Short);
    let shared = Folder::with(&text);
    let sweeps: Vec<_> =
        (0..2).map(|_| shared.start(["run", "sweep.toml", "--workers", "1"])).collect();
    for sweep in sweeps {
        let ended = sweep.wait().succeeded();
        let said = ended.stderr.to_lowercase();
        assert!(!said.contains("locked") && !said.contains("busy"), "{said}");
        assert!(said.contains("16 completed in all, 0 failed"), "{said}");
    }
    assert_eq!(shared.runs(), 16);
    assert_eq!(shared.number("SELECT count(*) FROM run WHERE status = 'completed'"), 16);
    assert_eq!(shared.number("SELECT count(DISTINCT session) FROM run"), 2);
    assert_same_rows(&shared.dump(), &Folder::completed(&text).dump());
}

#[test]
fn a_sweep_that_waits_takes_over_the_jobs_of_one_that_is_killed() {
    let text = manifest("sweep", "0.6", "1", Effort::Long);
    let folder = Folder::with(&text);
    let arguments = ["run", "sweep.toml", "--filter", "agent=reinforce", "--workers", "1"];
    let first = folder.start(arguments);
    until("the job runs", || folder.is_running_a_job());
    let second = folder.start(arguments);
    until("the second waits", || {
        second.stderr().contains("waiting for 1 job that another process is running")
    });
    first.kill();
    second.wait().succeeded().says("1 job run, 1 completed in all");
    let fate = |attempt: u32| {
        let sql = "SELECT status FROM run_summary WHERE attempt = ?1";
        let status = folder.store().query_row(sql, [attempt], |row| row.get::<_, String>(0));
        status.unwrap()
    };
    assert_eq!((fate(1).as_str(), fate(2).as_str()), ("interrupted", "completed"));
    assert_eq!(folder.runs(), 2);
}

/// The locks of a process on the store's file.
#[cfg(target_os = "linux")]
fn locks(folder: &Folder, process: u32) -> usize {
    use std::os::unix::fs::MetadataExt;
    let file = std::fs::metadata(folder.path("jitai.sqlite")).unwrap();
    // A line is like `1: POSIX  ADVISORY  READ 4711 fe:00:123456 1073741826 1073742335`.
    let (process, file) = (process.to_string(), format!(":{}", file.ino()));
    let locks = std::fs::read_to_string("/proc/locks").unwrap();
    let held = |line: &&str| {
        let fields: Vec<&str> = line.split_whitespace().collect();
        fields.get(4) == Some(&process.as_str())
            && fields.get(5).is_some_and(|f| f.ends_with(&file))
    };
    locks.lines().filter(held).count()
}

#[test]
fn clients_that_come_and_go_cost_a_killed_sweep_nothing() {
    let text = manifest("sweep", "[0.4, 0.6]", "25", Effort::Short);
    let folder = Folder::with(&text);
    let sweep = folder.start(["run", "sweep.toml", "--workers", "2", "--quiet"]);
    until("a job runs", || folder.is_running_a_job());
    // The last client that closes a store clears its log, if the client sees no others.
    let completed = || -> Vec<String> {
        let client = Connection::open_with_flags(
            folder.path("jitai.sqlite"),
            OpenFlags::SQLITE_OPEN_READ_WRITE,
        )
        .unwrap();
        let mut statement =
            client.prepare("SELECT job_key FROM run_summary WHERE status = 'completed'").unwrap();
        let keys = statement.query_map([], |row| row.get(0)).unwrap();
        keys.collect::<Result<_, _>>().unwrap()
    };
    // Recent clients also look for others outside the locks of the file; older clients do not.
    #[cfg(target_os = "linux")]
    assert!(locks(&folder, sweep.id()) > 0, "the sweep has lost its locks on the store");
    let mut before = Vec::new();
    for _ in 0..5 {
        folder.jitai(["status"]).succeeded();
        let so_far = before.len();
        until("some more are completed", || {
            before = completed();
            before.len() > so_far + 5
        });
    }
    sweep.kill();
    assert!(before.len() < 100, "the sweep was killed before its end");
    let after = completed();
    let lost: Vec<_> = before.iter().filter(|key| !after.contains(key)).collect();
    assert!(lost.is_empty(), "{lost:?}");
    folder.jitai(["run", "sweep.toml"]).succeeded().says("100 completed in all, 0 failed");
    assert_eq!(folder.number("SELECT count(*) FROM run WHERE status = 'completed'"), 100);
}

#[test]
fn readers_never_fail_while_a_sweep_runs() {
    let folder = Folder::with(&manifest("sweep", "[0.4, 0.6]", "4", Effort::Short));
    let mut sweep = folder.start(["run", "sweep.toml", "--workers", "2"]);
    until("a job runs", || folder.is_running_a_job());
    let mut readings = 0;
    while !sweep.has_ended() {
        folder.jitai(["status"]).succeeded().prints("sweep");
        let counting = "SELECT count(*) AS runs FROM run_summary JOIN metric USING (job_key)";
        folder.jitai(["query", counting]).succeeded().prints("runs");
        folder.jitai(["plan", "sweep.toml"]).succeeded().prints("sweep");
        folder.jitai(["export", "--out", "out"]).succeeded();
        let running = "SELECT count(*) FROM evaluation_episode";
        assert_eq!(folder.number(running) % 20, 0, "the episodes of a run come all at once");
        readings += 1;
    }
    assert!(readings >= 3, "{readings}");
    sweep.wait().succeeded().says("16 completed in all, 0 failed");
}

#[test]
fn a_reader_that_keeps_its_place_holds_up_no_sweep() {
    let folder = Folder::completed(&manifest("sweep", "0.6", "1", Effort::Trivial));
    let reader = folder.store();
    reader.execute_batch("BEGIN").unwrap();
    let count = || -> i64 {
        reader.query_row("SELECT count(*) FROM run_summary", [], |row| row.get(0)).unwrap()
    };
    assert_eq!(count(), 2);
    folder.write("sweep.toml", manifest("sweep", "0.6", "4", Effort::Trivial));
    folder.jitai(["run", "sweep.toml"]).succeeded().says("6 jobs run");
    assert_eq!(count(), 2, "it still sees the store as it was");
    reader.execute_batch("COMMIT").unwrap();
    assert_eq!(count(), 8);
}

#[test]
fn a_sweep_waits_for_a_stranger_that_writes() {
    let folder = Folder::completed(&manifest("sweep", "0.6", "1", Effort::Trivial));
    folder.write("sweep.toml", manifest("sweep", "0.6", "2", Effort::Trivial));
    let flags = OpenFlags::SQLITE_OPEN_READ_WRITE;
    let stranger = Connection::open_with_flags(folder.path("jitai.sqlite"), flags).unwrap();
    stranger.execute_batch("BEGIN IMMEDIATE").unwrap();
    let mut sweep = folder.start(["run", "sweep.toml"]);
    // Readers can query the store meanwhile.
    for _ in 0..5 {
        folder.jitai(["status"]).succeeded();
    }
    assert!(!sweep.has_ended());
    stranger.execute_batch("COMMIT").unwrap();
    sweep.wait().succeeded().says("2 jobs run, 4 completed in all");
}

#[test]
fn a_reader_finds_no_store_or_a_whole_one() {
    for _ in 0..10 {
        let folder = Folder::with(&manifest("sweep", "0.6", "1", Effort::Trivial));
        let sweep = folder.start(["run", "sweep.toml"]);
        loop {
            let status = folder.jitai(["query", "SELECT count(*) FROM run_summary"]);
            if status.code == Some(0) {
                break;
            }
            let said = status.ended(3).stderr;
            let early = ["there is no store at", "is an empty file"];
            assert!(early.iter().any(|early| said.contains(early)), "{said}");
        }
        sweep.wait().succeeded();
    }
}
