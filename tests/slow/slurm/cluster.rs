//! A cluster on loopback for one test, and a folder in which the program uses the cluster.

use std::collections::HashMap;
use std::env;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{LazyLock, Mutex};
use std::thread;
use std::time::{Duration, Instant};

use serde_json::Value;
use tempfile::TempDir;

use crate::support::{Finished, Folder, Running, assert_same_rows, left_out};

/// Maximum time that a test waits: two cores may run all tests at the same time.
const PATIENCE: Duration = Duration::from_secs(400);
/// Time between two checks of a condition.
const GLANCE: Duration = Duration::from_millis(100);

/// The variable that enables the tests, which start daemons as root.
const VARIABLE: &str = "JITAI_TEST_SLURM";

/// Whether Slurm is tried; if not, it is a part left out.
pub fn is_tried() -> bool {
    let is_tried = env::var_os(VARIABLE).is_some();
    if !is_tried {
        left_out("Slurm", "`make test-slurm` tries it");
    }
    is_tried
}

/// A Slurm cluster with three nodes.
pub struct Cluster {
    folder: TempDir,
}

impl Cluster {
    fn up(most_tasks: u32) -> Cluster {
        static USED: AtomicU32 = AtomicU32::new(0);
        let place = std::process::id() * 37 + USED.fetch_add(1, Ordering::Relaxed);
        let port = 20_000 + place % 1200 * 10;
        let cluster = Cluster { folder: tempfile::tempdir().unwrap() };
        let most_tasks = ("SLURM_TEST_MAX_ARRAY_SIZE", most_tasks.to_string());
        cluster.script(&["up", &port.to_string()], &[most_tasks]);
        cluster
    }

    fn script(&self, arguments: &[&str], variables: &[(&str, String)]) {
        let mut command = Command::new("tests/slow/slurm/cluster.sh");
        command.arg(arguments[0]).arg(self.folder.path()).args(&arguments[1..]);
        command.envs(variables.iter().map(|(name, value)| (name, value)));
        let output = command.output().unwrap();
        assert!(output.status.success(), "{arguments:?}: {}", text(&output.stderr));
    }

    fn configuration(&self) -> PathBuf {
        self.folder.path().join("slurm.conf")
    }

    /// The output of a Slurm program.
    pub fn slurm(&self, program: &str, arguments: &[&str]) -> String {
        let output = self.try_slurm(program, arguments);
        assert!(output.status.success(), "{program} {arguments:?}: {}", text(&output.stderr));
        text(&output.stdout)
    }

    fn try_slurm(&self, program: &str, arguments: &[&str]) -> Output {
        let mut command = Command::new(program);
        command.args(arguments).env("SLURM_CONF", self.configuration()).output().unwrap()
    }

    /// Cuts the power of a node; the controller notices at once.
    pub fn kill_node(&self, node: &str) {
        self.script(&["kill-node", node.trim_start_matches('n')], &[]);
        self.down(node);
    }

    /// Makes the controller consider a node lost.
    pub fn down(&self, node: &str) {
        let node = format!("nodename={node}");
        self.slurm("scontrol", &["update", &node, "state=down", "reason=test"]);
    }

    pub fn kill_controller(&self) {
        self.script(&["kill-controller"], &[]);
    }

    pub fn start_controller(&self) {
        self.script(&["start-controller"], &[]);
        until("the controller answers", || self.try_slurm("scontrol", &["ping"]).status.success());
    }
}

impl Drop for Cluster {
    fn drop(&mut self) {
        if thread::panicking() {
            eprintln!("{}", text(&self.try_slurm("squeue", &["--array"]).stdout));
        }
        self.script(&["down"], &[]);
    }
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// A folder with a manifest `sweep.toml` and a profile `cluster.toml`, and a cluster.
pub struct Lab {
    pub folder: Folder,
    pub cluster: Cluster,
    manifest: String,
    /// The program of the manifest's outside agent, if it has one.
    program: Option<&'static str>,
}

/// Three jobs that use no processor time and wait until the folder has a file `go`.
pub const WAITING_JOBS: &str = "format = 1
name = \"waiting\"
scenarios = [\"P-H-D\"]
seeds = 3
environment.sigma = 0.6
evaluation.test_episodes = 20
[[agent]]
name = \"patient\"
algorithm = \"external\"
command = [\"sh\", \"program.sh\"]
version = \"1\"
episodes = 3
";

/// The program of [`WAITING_JOBS`].
const WAITING_PROGRAM: &str = r#"
read -r line
echo '{"type":"ready","protocol":1}'
until [ -e go ]; do sleep 0.1; done
echo '{"type":"trained"}'
while read -r line; do
  case $line in
    *'"type":"act"'*)
      lanes=${line#*'"lanes":['}; lanes=${lanes%%]*}
      echo "{\"type\":\"choices\",\"actions\":[$(echo "$lanes" | sed 's/[0-9][0-9]*/1/g')]}";;
    *'"type":"end"'*) exit 0;;
  esac
done
exit 8
"#;

impl Lab {
    /// A lab for [`WAITING_JOBS`], with one chunk per job.
    pub fn waiting(profile: &str) -> Option<Lab> {
        let mut lab = Lab::in_three_chunks(WAITING_JOBS, profile)?;
        lab.folder.write("program.sh", WAITING_PROGRAM);
        lab.program = Some(WAITING_PROGRAM);
        Some(lab)
    }

    /// A lab whose cluster permits three tasks per array, and whose jobs would fill more. One of the
    /// tasks has the job id of the array.
    pub fn in_three_chunks(manifest: &str, profile: &str) -> Option<Lab> {
        Lab::with_arrays_of(3, manifest, &format!("chunk_minutes = 0.00001\n{profile}"))
    }

    /// A lab for a manifest; `None`, as a part left out, if tests with Slurm are disabled.
    pub fn with(manifest: &str, profile: &str) -> Option<Lab> {
        Lab::with_arrays_of(1001, manifest, profile)
    }

    /// The same lab, with at most `most_tasks` tasks per array.
    pub fn with_arrays_of(most_tasks: u32, manifest: &str, profile: &str) -> Option<Lab> {
        if !is_tried() {
            return None;
        }
        let folder = Folder::with(manifest);
        fs::create_dir(folder.path("scratch")).unwrap();
        let scratch = folder.path("scratch").display().to_string();
        let profile = match profile.contains("scratch =") {
            true => format!("engine = \"slurm\"\n{profile}\n"),
            false => format!("engine = \"slurm\"\nscratch = \"{scratch}\"\n{profile}\n"),
        };
        folder.write("cluster.toml", profile);
        let cluster = Cluster::up(most_tasks);
        Some(Lab { folder, cluster, manifest: manifest.to_owned(), program: None })
    }

    /// The program with arguments, in an environment in which it finds the cluster.
    pub fn command(&self, arguments: &[&str]) -> Command {
        let mut command = self.folder.command(arguments.iter().copied());
        command.env("SLURM_CONF", self.cluster.configuration());
        command
    }

    /// Starts the program.
    pub fn start(&self, arguments: &[&str]) -> Running {
        Running::of(self.command(arguments))
    }

    /// Runs the program to its end.
    #[track_caller]
    pub fn jitai(&self, arguments: &[&str]) -> Finished {
        self.start(arguments).wait_for(PATIENCE)
    }

    /// Submits the manifest, with further arguments.
    #[track_caller]
    pub fn submit(&self, more: &[&str]) -> Finished {
        let arguments = [&["submit", "sweep.toml", "--cluster", "cluster.toml"], more].concat();
        self.jitai(&arguments)
    }

    /// Submits with a folder of programs that precedes Slurm's own in the path; the program `name` has
    /// this `body`.
    pub fn submit_with_program(&self, name: &str, body: &str) -> Running {
        let bin = self.folder.path("bin");
        fs::create_dir_all(&bin).unwrap();
        let program = bin.join(name);
        fs::write(&program, format!("#!/bin/bash\nPATH=${{PATH#*:}}\n{body}\n")).unwrap();
        let mode = std::os::unix::fs::PermissionsExt::from_mode(0o755);
        fs::set_permissions(&program, mode).unwrap();
        let mut command = self.command(&["submit", "sweep.toml", "--cluster", "cluster.toml"]);
        let path = std::env::var("PATH").unwrap();
        command.env("PATH", format!("{}:{path}", bin.display()));
        Running::of(command)
    }

    /// The submissions, as shown by `status`.
    pub fn submissions(&self) -> Vec<Value> {
        let shown = self.jitai(&["status", "--submissions", "--format", "json"]).succeeded();
        shown.json().as_array().unwrap().clone()
    }

    fn submissions_made(&self) -> Vec<PathBuf> {
        let mut folders = files(&self.folder.path("jitai.sqlite.submissions"));
        folders.retain(|path| path.join("submission.json").is_file());
        folders
    }

    /// The folder of the latest submission.
    pub fn submission(&self) -> PathBuf {
        self.submissions_made().pop().expect("one was made")
    }

    /// The recorded attempts of the latest submission, the earliest first.
    pub fn attempts(&self) -> Vec<Value> {
        let mut attempts: Vec<Value> = files(&self.submission().join("attempts"))
            .iter()
            .map(|file| serde_json::from_slice(&fs::read(file).unwrap()).unwrap())
            .collect();
        let at = |attempt: &Value| attempt["started_at"].as_f64().unwrap();
        attempts.sort_by(|one, other| at(one).total_cmp(&at(other)));
        attempts
    }

    /// The logs of the latest submission.
    pub fn logs(&self) -> String {
        let read = |file: &PathBuf| fs::read_to_string(file).unwrap();
        files(&self.submission().join("logs")).iter().map(read).collect()
    }

    /// The sealed parts of a chunk of the latest submission.
    pub fn parts_of(&self, chunk: u32) -> Vec<PathBuf> {
        let mut parts = self.parts();
        let is_of_chunk = |name: &str| name.starts_with(&format!("{chunk}."));
        parts.retain(|part| is_of_chunk(&part.file_name().unwrap().to_string_lossy()));
        parts
    }

    /// The sealed parts of the latest submission.
    pub fn parts(&self) -> Vec<PathBuf> {
        let mut parts = files(&self.submission().join("parts"));
        parts.retain(|part| part.extension().is_some_and(|extension| extension == "sqlite"));
        parts
    }

    /// Waits until all three tasks of the latest array run jobs; returns the index of the task that has the
    /// job id of the array.
    #[track_caller]
    pub fn until_all_run(&self) -> u32 {
        let scratches = || self.logs().matches("scratch: ").count();
        until("three tasks run jobs", || self.tasks().len() == 3 && scratches() >= 3);
        let arguments = ["--noheader", "--array", "--format=%A|%F|%K"];
        let tasks = self.cluster.slurm("squeue", &arguments);
        let leader = tasks.lines().find_map(|line| {
            let fields: Vec<&str> = line.trim().split('|').collect();
            (fields[0] == fields[1]).then(|| fields[2].parse().unwrap())
        });
        leader.unwrap_or_else(|| panic!("no task has the id of its array: {tasks}"))
    }

    /// The ends of the attempts at each chunk of the latest submission, the earliest first.
    pub fn ends(&self) -> Vec<Vec<Value>> {
        let chunks = self.submissions().last().unwrap()["chunks"].as_u64().unwrap();
        let mut ends = vec![Vec::new(); usize::try_from(chunks).unwrap()];
        for attempt in self.attempts() {
            let chunk = usize::try_from(attempt["chunk"].as_u64().unwrap()).unwrap();
            ends[chunk].push(attempt["end"].clone());
        }
        ends
    }

    /// The id of the latest array.
    pub fn array(&self) -> String {
        fs::read_to_string(self.submission().join("array")).unwrap().trim().to_owned()
    }

    /// Waits until a task runs jobs; returns its node.
    #[track_caller]
    pub fn until_running(&self) -> String {
        until("a task runs jobs", || {
            self.task_process().is_some() && self.logs().contains("scratch: ")
        });
        let arguments = ["--noheader", "--states=RUNNING", "--format=%N"];
        let nodes = self.cluster.slurm("squeue", &arguments);
        nodes.lines().next().expect("a task runs").trim().to_owned()
    }

    /// The processes of this program that run tasks of the lab, each with its arguments.
    fn tasks(&self) -> Vec<(u32, Vec<String>)> {
        let folder = self.folder.path("jitai.sqlite.submissions").display().to_string();
        let words = |process: &u32| {
            let line = fs::read(format!("/proc/{process}/cmdline")).unwrap_or_default();
            text(&line).split('\0').map(str::to_owned).collect::<Vec<String>>()
        };
        let is_task = |words: &[String]| {
            words.len() > 4 && words[1] == "task" && words[2].starts_with(&folder)
        };
        let all = processes().into_iter().map(|process| (process, words(&process)));
        all.filter(|(_, words)| is_task(words)).collect()
    }

    /// A process of this program that runs a task of the lab, and its chunk.
    pub fn task_process(&self) -> Option<(u32, u32)> {
        let tasks = self.tasks();
        tasks.first().map(|(process, words)| (*process, words[4].parse().unwrap()))
    }

    /// The outside program that a chunk's task runs, or will run.
    pub fn program_of(&self, chunk: u32) -> u32 {
        let is_of_chunk = |(_, words): &(u32, Vec<String>)| words[4] == chunk.to_string();
        let (task, _) = self.tasks().into_iter().find(is_of_chunk).expect("the chunk runs");
        let is_program = |process: &u32| {
            let line = fs::read(format!("/proc/{process}/cmdline")).unwrap_or_default();
            text(&line).contains("program.sh")
                && stat(*process).is_some_and(|stat| stat[1] == task.to_string())
        };
        let mut program = None;
        until("its job has started its program", || {
            program = processes().into_iter().find(is_program);
            program.is_some()
        });
        program.unwrap()
    }

    /// A process that runs a task whose chunk contains the job, once its attempt is recorded.
    pub fn task_process_with(&self, key: &str) -> Option<u32> {
        let has_it = |(_, words): &(u32, Vec<String>)| {
            let (folder, chunk) = (Path::new(&words[2]), &words[4]);
            let keys = fs::read_to_string(folder.join("chunks").join(chunk)).unwrap_or_default();
            let of_chunk = format!("{chunk}.");
            keys.contains(key)
                && files(&folder.join("attempts"))
                    .iter()
                    .any(|file| file.file_name().unwrap().to_string_lossy().starts_with(&of_chunk))
        };
        self.tasks().into_iter().find(has_it).map(|(process, _)| process)
    }

    /// The process of a node's daemon.
    pub fn node_daemon(&self, node: &str) -> u32 {
        let configuration = self.cluster.configuration().display().to_string();
        let is_daemon = |process: &u32| {
            let line = text(&fs::read(format!("/proc/{process}/cmdline")).unwrap_or_default());
            let words: Vec<&str> = line.split('\0').collect();
            words.first() == Some(&"slurmd")
                && words.contains(&node)
                && words.contains(&configuration.as_str())
        };
        processes().into_iter().find(is_daemon).expect("the node is up")
    }

    /// Submits, waits until every job has ended, and compares the results with those of one machine.
    #[track_caller]
    pub fn finish(&self) {
        self.submit(&["--wait"]).succeeded();
        self.assert_as_on_one_machine();
    }

    /// Compares everything that the jobs determine with a run of the manifest on this machine alone.
    #[track_caller]
    pub fn assert_as_on_one_machine(&self) {
        static DUMPS: LazyLock<Mutex<HashMap<String, Vec<String>>>> = LazyLock::new(Mutex::default);
        let mut dumps = DUMPS.lock().unwrap();
        let expected = dumps.entry(self.manifest.clone()).or_insert_with(|| {
            let alone = Folder::with(&self.manifest);
            if let Some(program) = self.program {
                alone.write("program.sh", program);
                alone.write("go", "");
            }
            let run = Running::of(alone.command(["run", "sweep.toml", "--quiet"]));
            run.wait_for(PATIENCE).succeeded();
            alone.dump()
        });
        assert_same_rows(&self.folder.dump(), expected);
        self.jitai(&["doctor"]).succeeded();
    }
}

impl Drop for Lab {
    fn drop(&mut self) {
        let submissions = self.folder.path("jitai.sqlite.submissions");
        let is_one = || !self.submissions_made().is_empty();
        if thread::panicking() && submissions.exists() && is_one() {
            eprintln!("{}\n{:#?}", self.logs(), self.attempts());
        }
    }
}

/// The files in a folder, sorted, without unfinished files.
pub fn files(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let is_shown = |path: &PathBuf| !path.file_name().unwrap().to_string_lossy().starts_with('.');
    let mut files: Vec<PathBuf> = entries.filter(is_shown).collect();
    files.sort();
    files
}

fn processes() -> Vec<u32> {
    let entries = fs::read_dir("/proc").unwrap().flatten();
    entries.filter_map(|entry| entry.file_name().to_str()?.parse().ok()).collect()
}

/// The parent of a process.
pub fn parent(process: u32) -> u32 {
    stat(process).unwrap()[1].parse().unwrap()
}

/// Whether a process has ended: none of its threads still runs. It may be a zombie. Of a killed process the
/// first thread may be a zombie before the others have ended; only the end of the last one reaches its
/// children, which get another parent and perhaps a SIGHUP.
pub fn has_ended(process: u32) -> bool {
    let threads = fs::read_dir(format!("/proc/{process}/task"));
    let has_ended =
        |thread: &Path| fields(thread).is_none_or(|stat| stat[0] == "Z" || stat[0] == "X");
    threads.into_iter().flatten().flatten().all(|thread| has_ended(&thread.path()))
}

fn stat(process: u32) -> Option<Vec<String>> {
    fields(Path::new(&format!("/proc/{process}")))
}

/// The fields of the `stat` file in a process's or a thread's folder of `/proc` after the name: the state,
/// the parent and so on.
fn fields(folder: &Path) -> Option<Vec<String>> {
    let stat = fs::read_to_string(folder.join("stat")).ok()?;
    let behind_name = stat.rsplit_once(')')?.1;
    Some(behind_name.split_whitespace().map(str::to_owned).collect())
}

/// Sends a signal to a process.
pub fn signal(process: u32, name: &str) {
    let kill = format!("kill -{name} {process}");
    assert!(Command::new("sh").args(["-c", &kill]).status().unwrap().success(), "{kill}");
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
