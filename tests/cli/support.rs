//! A working folder that runs the program, and the content of its store.

use std::env;
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::PathBuf;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use rusqlite::{Connection, OpenFlags};
use tempfile::TempDir;

/// Maximum time that a test waits for an expected event.
const PATIENCE: Duration = Duration::from_secs(120);
/// Maximum time of a stop, as promised to users.
const STOPS_WITHIN: Duration = Duration::from_secs(2);
/// Time between two checks of the event.
const GLANCE: Duration = Duration::from_millis(2);

/// Columns that depend on the circumstances of a run, not on the content of its job.
pub const CIRCUMSTANCES: [&str; 9] = [
    "attempt",
    "wall_seconds",
    "started_at",
    "ended_at",
    "code_version",
    "host",
    "processor",
    "backend",
    "git_revision",
];

/// The duration of the jobs of a [`manifest`].
#[derive(Clone, Copy, Debug)]
pub enum Effort {
    /// Milliseconds.
    Trivial,
    /// About 100 ms.
    Short,
    /// About 2 s.
    Long,
    /// Longer than any test.
    Endless,
}

/// A manifest of P-H-D with both agents; `sigma` and `seeds` are in TOML.
pub fn manifest(name: &str, sigma: &str, seeds: &str, effort: Effort) -> String {
    let (dqn, reinforce) = match effort {
        Effort::Trivial => (10, 10),
        Effort::Short => (200, 6_000),
        Effort::Long => (4_000, 120_000),
        Effort::Endless => (1_000_000, 10_000_000),
    };
    format!(
        "format = 1
name = \"{name}\"
scenarios = [\"P-H-D\"]
seeds = {seeds}
environment.sigma = {sigma}
evaluation.test_episodes = 20
[[agent]]
name = \"dqn\"
algorithm = \"dueling_dqn\"
episodes = {dqn}
layers = [32, 32]
[[agent]]
name = \"reinforce\"
algorithm = \"reinforce\"
episodes = {reinforce}
layers = [32]
"
    )
}

/// A temporary folder in which the program runs; its store is the default one.
pub struct Folder(TempDir);

impl Folder {
    pub fn new() -> Self {
        Folder(tempfile::tempdir().unwrap())
    }

    /// A folder with a manifest called `sweep.toml`.
    pub fn with(manifest: &str) -> Self {
        let folder = Folder::new();
        folder.write("sweep.toml", manifest);
        folder
    }

    /// A folder in which all jobs of the manifest `sweep.toml` are completed.
    pub fn completed(manifest: &str) -> Self {
        let folder = Folder::with(manifest);
        folder.jitai(["run", "sweep.toml"]).succeeded();
        folder
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    pub fn write(&self, name: &str, text: impl AsRef<[u8]>) {
        fs::write(self.path(name), text).unwrap();
    }

    pub fn read(&self, name: &str) -> String {
        fs::read_to_string(self.path(name)).unwrap()
    }

    /// A command for the program, which heeds signals even if this process ignores them, as a background
    /// command of a shell ignores SIGINT.
    pub fn command<'a>(&self, arguments: impl IntoIterator<Item = &'a str>) -> Command {
        let program = env!("CARGO_BIN_EXE_jitai");
        if ignored_signals() & (1 << 1 | 1) == 0 {
            return self.command_of(program, arguments);
        }
        let heeding = ["--default-signal=HUP,INT", program];
        self.command_of("/usr/bin/env", heeding.into_iter().chain(arguments))
    }

    /// A command for another program in this folder.
    pub fn command_of<'a>(
        &self,
        program: &str,
        arguments: impl IntoIterator<Item = &'a str>,
    ) -> Command {
        let mut command = Command::new(program);
        command.args(arguments).current_dir(self.0.path()).env_remove("JITAI_STORE");
        command.env_remove("COLUMNS");
        command.stdin(Stdio::null());
        command
    }

    /// Runs the program to its end.
    pub fn jitai<'a>(&self, arguments: impl IntoIterator<Item = &'a str>) -> Finished {
        self.start(arguments).wait()
    }

    /// Starts the program.
    pub fn start<'a>(&self, arguments: impl IntoIterator<Item = &'a str>) -> Running {
        Running::of(self.command(arguments))
    }

    /// A connection to the store that bypasses the program.
    pub fn store(&self) -> Connection {
        Connection::open_with_flags(
            self.path("jitai.sqlite"),
            OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX,
        )
        .unwrap()
    }

    /// A number from the store.
    pub fn number(&self, sql: &str) -> i64 {
        self.store()
            .query_row(sql, [], |row| row.get(0))
            .unwrap_or_else(|error| panic!("{sql}: {error}"))
    }

    /// Number of runs of any status.
    pub fn runs(&self) -> i64 {
        self.number("SELECT count(*) FROM run")
    }

    /// A number from the store; `None` if it cannot be read yet.
    pub fn count_if_there(&self, sql: &str) -> Option<i64> {
        let store = Connection::open_with_flags(
            self.path("jitai.sqlite"),
            OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX,
        );
        store.ok()?.query_row(sql, [], |row| row.get(0)).ok()
    }

    /// Whether a run is under way; `false` if there is no store yet.
    pub fn is_running_a_job(&self) -> bool {
        self.count_if_there("SELECT count(*) FROM run WHERE status = 'running'") > Some(0)
    }

    /// Everything that the jobs determine, in a fixed order: the weights and every public view, without
    /// the columns of circumstances and without interrupted runs.
    pub fn dump(&self) -> Vec<String> {
        let store = self.store();
        let mut lines = Vec::new();
        // A row of arm_summary depends on the other jobs of its experiment, a row of manifest on the
        // time of the run, and a row of conflict on merges.
        let left_out = ["arm_summary", "manifest", "conflict"];
        for view in views(&store).into_iter().filter(|view| !left_out.contains(&view.as_str())) {
            let columns: Vec<String> = columns(&store, &view)
                .into_iter()
                .filter(|column| !CIRCUMSTANCES.contains(&column.as_str()))
                .collect();
            let ended = match view.as_str() {
                "run_summary" => "WHERE status IN ('completed', 'failed')",
                _ => "",
            };
            let sql = format!("SELECT {} FROM {view} {ended}", columns.join(", "));
            lines.extend(rows(&store, &sql).into_iter().map(|row| format!("{view}: {row}")));
        }
        let weights = "SELECT job.key, hex(safetensors) FROM trained_weights
             JOIN run ON run.id = trained_weights.run JOIN job ON job.id = run.job";
        lines.extend(rows(&store, weights).into_iter().map(|row| format!("weights: {row}")));
        lines.sort();
        lines
    }

    /// Every row of the public views, with every column.
    pub fn everything(&self) -> Vec<String> {
        let store = self.store();
        let of_view = |view: &String| rows(&store, &format!("SELECT * FROM {view}"));
        views(&store).iter().flat_map(of_view).collect()
    }
}

/// The signals that this process ignores; bit n - 1 stands for signal n.
fn ignored_signals() -> u64 {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    mask.map_or(0, |mask| u64::from_str_radix(mask.trim(), 16).unwrap())
}

pub fn views(store: &Connection) -> Vec<String> {
    let mut statement =
        store.prepare("SELECT name FROM sqlite_schema WHERE type = 'view' ORDER BY name").unwrap();
    let names = statement.query_map([], |row| row.get(0)).unwrap();
    names.collect::<Result<_, _>>().unwrap()
}

pub fn columns(store: &Connection, view: &str) -> Vec<String> {
    let statement = store.prepare(&format!("SELECT * FROM {view}")).unwrap();
    statement.column_names().map(str::to_owned).collect()
}

/// The rows of an answer as text, with all digits of numbers.
pub fn rows(store: &Connection, sql: &str) -> Vec<String> {
    let mut statement = store.prepare(sql).unwrap();
    let columns = statement.column_count();
    let row_text = |row: &rusqlite::Row<'_>| {
        let values = (0..columns).map(|column| row.get::<_, rusqlite::types::Value>(column));
        let values = values.collect::<rusqlite::Result<Vec<_>>>()?;
        Ok(format!("{values:?}"))
    };
    statement.query_map([], row_text).unwrap().collect::<Result<_, _>>().unwrap()
}

/// Fails with the first row that only one of the two dumps has.
#[track_caller]
pub fn assert_same_rows(ours: &[String], theirs: &[String]) {
    let differing = ours.iter().zip(theirs).find(|(one, other)| one != other);
    if let Some((one, other)) = differing {
        let cut = |line: &str| line.chars().take(400).collect::<String>();
        panic!("rows differ:\n{}\n{}", cut(one), cut(other));
    }
    assert_eq!(ours.len(), theirs.len(), "one dump has more rows");
}

/// Whether an environment variable has the value 1.
fn is_set(variable: &str) -> bool {
    env::var(variable).is_ok_and(|value| value == "1")
}

/// Says that a part of the tests cannot run here; fails with `JITAI_REQUIRE_ALL=1`.
#[track_caller]
pub fn left_out(part: &str, why: &str) {
    assert!(!is_set("JITAI_REQUIRE_ALL"), "JITAI_REQUIRE_ALL is 1, and {part} cannot run: {why}");
    // The test runner hides what a passing test prints, but not what it writes.
    let line = format!("left out: {part}: {why}\n");
    io::stderr().write_all(line.as_bytes()).unwrap();
}

/// Whether times are compared with what users were promised: not in `make test`, where a machine with
/// other work could break them, but in `make test-times`.
pub fn is_timed() -> bool {
    is_set("JITAI_TIMED")
}

/// Fails if more than `most` has passed since `begun` and times are compared.
#[track_caller]
pub fn assert_within(most: Duration, begun: Instant) {
    let took = begun.elapsed();
    assert!(!is_timed() || took < most, "it took {took:?}");
}

/// Fails if a stop that was requested at `asked` took longer than promised and times are compared.
#[track_caller]
pub fn assert_prompt(asked: Instant) {
    assert_within(STOPS_WITHIN, asked);
}

/// Waits until `condition` holds.
#[track_caller]
pub fn until(what: &str, mut condition: impl FnMut() -> bool) {
    let begun = Instant::now();
    while !condition() {
        assert!(begun.elapsed() < PATIENCE, "waited in vain until {what}");
        thread::sleep(GLANCE);
    }
}

/// A running program; killed if the test ends first.
pub struct Running {
    child: Child,
    streams: TempDir,
}

impl Running {
    /// Starts a command.
    pub fn of(mut command: Command) -> Running {
        let streams = tempfile::tempdir().unwrap();
        let stream = |name: &str| File::create(streams.path().join(name)).unwrap();
        let (stdout, stderr) = (stream("stdout"), stream("stderr"));
        let child = command.stdout(stdout).stderr(stderr).spawn().unwrap();
        Running { child, streams }
    }

    /// Standard error so far.
    pub fn stderr(&self) -> String {
        self.stream("stderr")
    }

    /// Standard output so far.
    pub fn stdout(&self) -> String {
        self.stream("stdout")
    }

    fn stream(&self, name: &str) -> String {
        let bytes = fs::read(self.streams.path().join(name)).unwrap();
        String::from_utf8_lossy(&bytes).into_owned()
    }

    pub fn has_ended(&mut self) -> bool {
        self.child.try_wait().unwrap().is_some()
    }

    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Sends a signal by its name, such as `INT`.
    pub fn signal(&self, name: &str) {
        let kill = format!("kill -{name} {}", self.child.id());
        assert!(Command::new("sh").args(["-c", &kill]).status().unwrap().success(), "{kill}");
    }

    /// Kills the program with SIGKILL.
    pub fn kill(mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }

    /// Waits for the end of the program.
    #[track_caller]
    pub fn wait(self) -> Finished {
        self.wait_for(PATIENCE)
    }

    /// Waits for the end of the program, for at most `patience`.
    #[track_caller]
    pub fn wait_for(mut self, patience: Duration) -> Finished {
        let mut status: Option<ExitStatus> = None;
        let begun = Instant::now();
        while status.is_none() {
            if begun.elapsed() >= patience {
                panic!("waited in vain for the program's end: {}{}", self.stdout(), self.stderr());
            }
            thread::sleep(GLANCE);
            status = self.child.try_wait().unwrap();
        }
        Finished {
            code: status.and_then(|status| status.code()),
            stdout: self.stdout(),
            stderr: self.stderr(),
        }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        // The program may already have ended.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A program that has ended.
#[derive(Debug)]
pub struct Finished {
    /// Exit code; `None` if a signal ended it.
    pub code: Option<i32>,
    pub stdout: String,
    pub stderr: String,
}

impl Finished {
    #[track_caller]
    pub fn succeeded(self) -> Self {
        self.ended(0)
    }

    /// Asserts the exit code, and that nothing panicked.
    #[track_caller]
    pub fn ended(self, code: i32) -> Self {
        assert_eq!(self.code, Some(code), "{}\n{}", self.stdout, self.stderr);
        assert!(!self.stderr.contains("panicked at"), "{}", self.stderr);
        self
    }

    /// Asserts that standard error contains a text.
    #[track_caller]
    pub fn says(self, text: &str) -> Self {
        assert!(self.stderr.contains(text), "{text:?} is not in {:?}", self.stderr);
        self
    }

    /// Asserts that standard output contains a text.
    #[track_caller]
    pub fn prints(self, text: &str) -> Self {
        assert!(self.stdout.contains(text), "{text:?} is not in {:?}", self.stdout);
        self
    }

    /// Standard output as JSON.
    #[track_caller]
    pub fn json(&self) -> serde_json::Value {
        serde_json::from_str(&self.stdout)
            .unwrap_or_else(|error| panic!("{error}: {}", self.stdout))
    }
}
