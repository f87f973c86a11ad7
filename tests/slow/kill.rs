//! Sweeps that are killed repeatedly, at random moments and at every point at which data is written,
//! end in the store of an undisturbed sweep.
//!
//! `KILLS` is the total number of kills, and `SEED` repeats the choices of an earlier run; the random
//! moments are only as exact as the machine. Prints a table. Run by `make test-kill`.

use std::collections::BTreeMap;
use std::env;
use std::fs::{self, File};
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use jitai::kill_point::{KillPoint, VARIABLE};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use crate::support::Folder;

/// Default of `KILLS`.
const KILLS: u64 = 500;
/// Number of kills after which a sweep is left undisturbed and has to end.
const MOST_KILLS_OF_A_SWEEP: u64 = 30;
/// Maximum time of a program that is not killed.
const PATIENCE: Duration = Duration::from_secs(120);
/// The number of the signal SIGKILL.
const SIGKILL: i32 = 9;

/// A trial of 500 people with what does not go as planned.
const TRIAL: &str = "evaluation = { on = \"trial\", record_decisions = \"test\" }\n\
    trial = { people = 500, days = 10, decisions_per_day = 5, entry_every_days = 1, entry_people = 125, \
    pooling = [\"full\", \"none\"], update_every_days = 3, dropout = 0.02, missing_outcomes = 0.1, unreported = 0.2 }";

/// The kind of jobs in a sweep.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Jobs {
    Trivial,
    Dqn,
    Reinforce,
    Rules,
    Trial,
    Failing,
}

impl Jobs {
    const ALL: [Jobs; 6] =
        [Jobs::Trivial, Jobs::Dqn, Jobs::Reinforce, Jobs::Rules, Jobs::Trial, Jobs::Failing];

    fn name(self) -> &'static str {
        match self {
            Jobs::Trivial => "trivial",
            Jobs::Dqn => "DQN",
            Jobs::Reinforce => "REINFORCE",
            Jobs::Rules => "rules",
            Jobs::Trial => "trial",
            Jobs::Failing => "failing",
        }
    }

    /// Whether the jobs take long enough to leave checkpoints.
    fn leave_checkpoints(self) -> bool {
        matches!(self, Jobs::Dqn | Jobs::Reinforce)
    }

    /// Exit code of `jitai run` once every job has ended.
    fn exit_code(self) -> i32 {
        match self {
            Jobs::Trivial | Jobs::Dqn | Jobs::Reinforce | Jobs::Rules | Jobs::Trial => 0,
            Jobs::Failing => 1,
        }
    }

    /// The manifest.
    fn text(self) -> String {
        let (seeds, evaluation) = match self {
            Jobs::Trivial => (8, "evaluation.test_episodes = 20"),
            Jobs::Dqn | Jobs::Reinforce => (3, "evaluation.test_episodes = 50"),
            Jobs::Rules => (4, "evaluation.test_episodes = 1000"),
            Jobs::Trial => (4, TRIAL),
            Jobs::Failing => (2, "evaluation.test_episodes = 20"),
        };
        let mut text = format!(
            "format = 1\nname = \"sweep\"\nscenarios = [\"P-H-D\"]\nseeds = {seeds}\n\
             environment.sigma = 0.6\n{evaluation}\n"
        );
        let mut agent = |name: &str, algorithm: &str, keys: &str| {
            let head = format!("[[agent]]\nname = \"{name}\"\nalgorithm = \"{algorithm}\"\n");
            text.extend([&head, keys, "\n"]);
        };
        match self {
            Jobs::Trivial => {
                agent("dqn", "dueling_dqn", "episodes = 10\nlayers = [8]");
                agent("reinforce", "reinforce", "episodes = 10\nlayers = [8]");
            }
            Jobs::Dqn => agent("dqn", "dueling_dqn", "episodes = 500\nlayers = [32, 32]"),
            Jobs::Reinforce => agent("reinforce", "reinforce", "episodes = 15000\nlayers = [32]"),
            Jobs::Rules => {
                agent("never", "rule", "rule = \"never\"");
                agent("untailored", "rule", "rule = \"untailored\"");
                agent("tailored", "rule", "rule = \"tailored\"");
            }
            Jobs::Trial => agent("thompson", "linear_thompson", "noise_sd = 40"),
            Jobs::Failing => {
                // The loss overflows at the second update.
                let layers = ["64"; 24].join(", ");
                let wild = format!("episodes = 50\nlayers = [{layers}]\nbatch = 8");
                agent("wild", "dueling_dqn", &format!("{wild}\nlearning_rate = 1.0"));
                agent("tame", "reinforce", "episodes = 10\nlayers = [8]");
            }
        }
        text
    }
}

/// How a sweep is killed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Way {
    /// A process at a random moment.
    Process,
    /// A group of two processes that share the store, at a random moment.
    Group,
    /// A process at one of its kill points.
    Place(KillPoint),
}

impl Way {
    fn all() -> Vec<Way> {
        [Way::Process, Way::Group].into_iter().chain(KillPoint::ALL.map(Way::Place)).collect()
    }

    fn name(self) -> String {
        match self {
            Way::Process => "a process, at random moments".to_owned(),
            Way::Group => "a group of two processes on one store, at random moments".to_owned(),
            Way::Place(place) => format!("a process, at `{}`", place.name()),
        }
    }

    /// Whether sweeps of these jobs can be killed in this way.
    fn suits(self, jobs: Jobs) -> bool {
        match self {
            Way::Place(KillPoint::CheckpointWritten | KillPoint::CheckpointRenamed) => {
                jobs.leave_checkpoints()
            }
            Way::Place(
                KillPoint::BeforeCommit | KillPoint::AfterCommit | KillPoint::EndsStored,
            )
            | Way::Process
            | Way::Group => true,
        }
    }

    /// Maximum number of times that a point is passed before the process is killed. Short jobs are all
    /// claimed before the first of them is stored, each in its own transaction.
    fn most_passes(place: KillPoint) -> u64 {
        match place {
            KillPoint::BeforeCommit | KillPoint::AfterCommit => 24,
            KillPoint::CheckpointWritten | KillPoint::CheckpointRenamed => 4,
            KillPoint::EndsStored => 3,
        }
    }
}

/// The result of an undisturbed sweep.
struct Undisturbed {
    rows: Vec<String>,
    /// Duration of the sweep.
    took: Duration,
}

/// State that all sweeps share.
struct Harness {
    seed: u64,
    /// A copy, so that the program may be rebuilt during the test.
    program: PathBuf,
    undisturbed: BTreeMap<Jobs, Undisturbed>,
    kills_left: AtomicU64,
    kills: Mutex<BTreeMap<(String, Jobs), u64>>,
    sweeps: AtomicU64,
    differences: Mutex<Vec<(String, String)>>,
}

/// A number from 0 to 1, excluding 1.
fn unit(chance: &mut ChaCha8Rng) -> f64 {
    f64::from(chance.next_u32()) / 4_294_967_296.0
}

/// A number from 1 to `most`.
fn up_to(chance: &mut ChaCha8Rng, most: u64) -> u64 {
    1 + u64::from(chance.next_u32()) % most
}

/// A process of a running sweep; killed if the harness ends first.
struct Process(Child);

impl Drop for Process {
    fn drop(&mut self) {
        // The process may already have ended.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl Process {
    /// Waits for the end of the process; `None` if it does not end within `patience`.
    fn ends_within(&mut self, patience: Duration) -> Option<ExitStatus> {
        let begun = Instant::now();
        loop {
            if let Some(status) = self.0.try_wait().unwrap() {
                return Some(status);
            }
            if begun.elapsed() >= patience {
                return None;
            }
            thread::sleep(Duration::from_millis(1));
        }
    }

    #[track_caller]
    fn end(mut self) -> ExitStatus {
        self.ends_within(PATIENCE).expect("a program that nobody kills ends")
    }
}

/// One sweep: killed until it is done, or until the maximum number of kills.
struct Sweep<'a> {
    harness: &'a Harness,
    jobs: Jobs,
    way: Way,
    chance: ChaCha8Rng,
    folder: Folder,
    kills: u64,
}

impl Sweep<'_> {
    /// The command, with a random number of workers and checkpoints at the shortest interval.
    fn command(&mut self) -> Command {
        let workers = up_to(&mut self.chance, 4).to_string();
        let arguments =
            ["run", "sweep.toml", "--workers", &workers, "--checkpoint-every", "0.01", "--quiet"];
        let mut command = self.folder.command_of(self.harness.program.to_str().unwrap(), arguments);
        let told = File::options().create(true).append(true).open(self.folder.path("told"));
        command.stdout(Stdio::null()).stderr(told.unwrap());
        command
    }

    /// A random time until the kill, more often short than long.
    fn delay(&mut self) -> Duration {
        let part = unit(&mut self.chance);
        self.harness.undisturbed[&self.jobs].took.mul_f64(1.2 * part * part)
    }

    /// Runs the sweep once; returns how it ended, or `None` if it was killed.
    fn attempt(&mut self) -> Option<ExitStatus> {
        match self.way {
            Way::Process => {
                let mut process = Process(self.command().spawn().unwrap());
                let ended = process.ends_within(self.delay());
                if ended.is_none() {
                    process.0.kill().unwrap();
                }
                Some(process.end())
            }
            Way::Group => self.attempt_of_a_group(),
            Way::Place(place) => {
                let passes = up_to(&mut self.chance, Way::most_passes(place));
                let chosen = format!("{}:{passes}", place.name());
                Some(Process(self.command().env(VARIABLE, chosen).spawn().unwrap()).end())
            }
        }
        .filter(|status| status.signal() != Some(SIGKILL))
    }

    fn attempt_of_a_group(&mut self) -> Option<ExitStatus> {
        let mut first = Process(self.command().process_group(0).spawn().unwrap());
        let group = i32::try_from(first.0.id()).unwrap();
        let second = Process(self.command().process_group(group).spawn().unwrap());
        if first.ends_within(self.delay()).is_none() {
            let kill = format!("kill -s KILL -- -{group}");
            assert!(Command::new("sh").args(["-c", &kill]).status().unwrap().success(), "{kill}");
        }
        let (first, second) = (first.end(), second.end());
        // Both processes ended by themselves, both were killed, or one ended before the other was
        // killed.
        if second.signal() == Some(SIGKILL) { Some(second) } else { Some(first) }
    }

    /// Kills the sweep until it is done, and compares the store.
    ///
    /// **Errors**: the difference from the undisturbed sweep.
    fn run(&mut self) -> Result<(), String> {
        let ended = loop {
            if self.kills == MOST_KILLS_OF_A_SWEEP {
                break Process(self.command().spawn().unwrap()).end();
            }
            match self.attempt() {
                Some(ended) => break ended,
                None => self.kills += 1,
            }
        };
        let told = fs::read_to_string(self.folder.path("told")).unwrap();
        if ended.code() != Some(self.jobs.exit_code()) {
            return Err(format!("it ended with {ended}: {told}"));
        }
        if told.contains("panicked at") || told.contains(" rejected: ") {
            return Err(told);
        }
        self.check()
    }

    fn check(&self) -> Result<(), String> {
        let ours = self.folder.dump();
        let theirs = &self.harness.undisturbed[&self.jobs].rows;
        if ours != *theirs {
            let differing = ours.iter().zip(theirs).find(|(our, their)| our != their);
            let shown: String = format!("{differing:?}").chars().take(800).collect();
            return Err(format!("{} rows for {}: {shown}", ours.len(), theirs.len()));
        }
        let ends = "SELECT count(*) FROM job WHERE 1 <> (SELECT count(*) FROM run
             WHERE run.job = job.id AND status IN ('completed', 'failed'))";
        let running = "SELECT count(*) FROM run WHERE status = 'running'";
        for (what, sql) in [("jobs without one end", ends), ("runs under way", running)] {
            match self.folder.number(sql) {
                0 => {}
                count => return Err(format!("{count} {what}")),
            }
        }
        if self.folder.path("jitai.sqlite.checkpoints").exists() {
            return Err("checkpoints have stayed".to_owned());
        }
        let mut names = fs::read_dir(self.folder.path("")).unwrap().map(|e| e.unwrap().file_name());
        if let Some(mark) = names.find(|name| name.to_str().unwrap().contains("-session-")) {
            return Err(format!("{} has stayed", mark.display()));
        }
        let doctor = self.folder.command_of(self.harness.program.to_str().unwrap(), ["doctor"]);
        let doctor = { doctor }.output().unwrap();
        match doctor.status.code() {
            Some(0) => Ok(()),
            _ => Err(format!("doctor: {}", String::from_utf8_lossy(&doctor.stdout))),
        }
    }
}

impl Harness {
    fn new(place: &Path, seed: u64, kills: u64) -> Harness {
        let program = place.join("jitai");
        fs::copy(env!("CARGO_BIN_EXE_jitai"), &program).unwrap();
        let undisturbed = Jobs::ALL.map(|jobs| {
            let folder = Folder::with(&jobs.text());
            let begun = Instant::now();
            folder.jitai(["run", "sweep.toml", "--workers", "2"]).ended(jobs.exit_code());
            let took = begun.elapsed();
            (jobs, Undisturbed { rows: folder.dump(), took })
        });
        Harness {
            seed,
            program,
            undisturbed: undisturbed.into(),
            kills_left: AtomicU64::new(kills),
            kills: Mutex::default(),
            sweeps: AtomicU64::new(0),
            differences: Mutex::default(),
        }
    }

    /// Runs sweeps until the number of kills is reached.
    fn work(&self, suits: &[(Way, Jobs)]) {
        while self.kills_left.load(Ordering::Relaxed) > 0 {
            let number = self.sweeps.fetch_add(1, Ordering::Relaxed);
            let (way, jobs) = suits[number as usize % suits.len()];
            let mut chance = ChaCha8Rng::seed_from_u64(self.seed);
            chance.set_stream(number);
            let folder = Folder::with(&jobs.text());
            let mut sweep = Sweep { harness: self, jobs, way, chance, folder, kills: 0 };
            let result = sweep.run();
            let kills = sweep.kills;
            *self.kills.lock().unwrap().entry((way.name(), jobs)).or_default() += kills;
            let left = |left: u64| Some(left.saturating_sub(kills));
            let _ = self.kills_left.fetch_update(Ordering::Relaxed, Ordering::Relaxed, left);
            if let Err(difference) = result {
                let told = format!("sweep {number}, {jobs:?}, killed {kills} times: {difference}");
                println!("{told}");
                self.differences.lock().unwrap().push((way.name(), told));
            }
        }
    }

    /// A table of the kills by way and kind of jobs, with the number of differences found.
    fn table(&self) -> String {
        let (kills, differences) = (self.kills.lock().unwrap(), self.differences.lock().unwrap());
        let names = Jobs::ALL.map(Jobs::name).join(" | ");
        let mut table = format!("| killed | {names} | kills | differences |\n| --- |");
        table.push_str(&" --- |".repeat(Jobs::ALL.len() + 2));
        for way in Way::all() {
            let count = |jobs| kills.get(&(way.name(), jobs)).copied();
            let cells =
                Jobs::ALL.map(|jobs| count(jobs).map_or("–".to_owned(), |n| n.to_string()));
            let all: u64 = Jobs::ALL.into_iter().filter_map(count).sum();
            let differing = differences.iter().filter(|(name, _)| *name == way.name()).count();
            let cells = cells.join(" | ");
            table.push_str(&format!("\n| {} | {cells} | {all} | {differing} |", way.name()));
        }
        let all: u64 = kills.values().sum();
        let sums = Jobs::ALL.map(|jobs| {
            let of_jobs = kills.iter().filter(|((_, theirs), _)| *theirs == jobs);
            of_jobs.map(|(_, count)| count).sum::<u64>().to_string()
        });
        let sums = sums.join(" | ");
        table.push_str(&format!("\n| all | {sums} | {all} | {} |\n", differences.len()));
        table
    }
}

/// A whole number from an environment variable.
fn asked(name: &str) -> Option<u64> {
    let text = env::var(name).ok().filter(|text| !text.is_empty())?;
    Some(text.parse().unwrap_or_else(|_| panic!("{name} is `{text}`; expected a whole number")))
}

#[test]
fn killed_sweeps_end_in_the_store_of_an_undisturbed_one() {
    let clock = || SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_secs();
    let (seed, kills) = (asked("SEED").unwrap_or_else(clock), asked("KILLS").unwrap_or(KILLS));
    println!("SEED={seed} KILLS={kills}");
    let begun = Instant::now();
    let place = tempfile::tempdir().unwrap();
    let harness = Harness::new(place.path(), seed, kills);
    let pairs = |way: Way| Jobs::ALL.into_iter().map(move |jobs| (way, jobs));
    let mut suits: Vec<(Way, Jobs)> = Way::all().into_iter().flat_map(pairs).collect();
    suits.retain(|(way, jobs)| way.suits(*jobs));
    let workers = thread::available_parallelism().unwrap().get();
    thread::scope(|scope| {
        for _ in 0..workers {
            scope.spawn(|| harness.work(&suits));
        }
    });
    let (sweeps, took) = (harness.sweeps.load(Ordering::Relaxed), begun.elapsed().as_secs());
    println!("\n{}\n{sweeps} sweeps in {took} s", harness.table());
    let differences = harness.differences.into_inner().unwrap();
    assert!(differences.is_empty(), "{} sweeps differ; SEED={seed} tries again", differences.len());
    // With fewer sweeps, all sweeps of a way may have ended before the first kill.
    if sweeps >= 2 * suits.len() as u64 {
        let kills = harness.kills.into_inner().unwrap();
        let has_killed =
            |way: &Way| kills.iter().any(|((name, _), count)| *name == way.name() && *count > 0);
        let unused = Way::all().into_iter().filter(|way| !has_killed(way));
        assert_eq!(unused.map(Way::name).collect::<Vec<_>>(), [""; 0], "ways that killed nothing");
    }
}

/// Jobs of several seconds: training, test episodes, and a trial.
const LONG: [(&str, &str, &str); 3] = [
    (
        "training",
        "evaluation.test_episodes = 50",
        "algorithm = \"dueling_dqn\"\nepisodes = 1500\nlayers = [64, 64]",
    ),
    (
        "test",
        "environment.horizon = 1000\nenvironment.epsilon_d = 0.0\nevaluation.test_episodes = 100000",
        "algorithm = \"rule\"\nrule = \"tailored\"",
    ),
    (
        "trial",
        "environment.horizon = 300\nevaluation.on = \"trial\"\ntrial = { people = 5000, days = 60, decisions_per_day = 5, \
         entry_every_days = 1, entry_people = 125, update_every_days = 1 }",
        "algorithm = \"linear_thompson\"\nnoise_sd = 40",
    ),
];

/// More kills than a sweep of [`LONG`] takes on a machine with other work.
const MOST_KILLS: u32 = 100;

#[test]
fn jobs_get_further_under_kills_at_any_spacing() {
    for (name, evaluation, agent) in LONG {
        let text = format!(
            "format = 1\nname = \"sweep\"\nscenarios = [\"P-H-D\"]\nseeds = 2\nenvironment.sigma = 0.6\n\
             {evaluation}\n[[agent]]\nname = \"{name}\"\n{agent}\n"
        );
        let undisturbed = Folder::with(&text);
        let begun = Instant::now();
        undisturbed.jitai(["run", "sweep.toml", "--workers", "1"]).succeeded();
        let took = begun.elapsed();
        let rows = undisturbed.dump();
        for milliseconds in [1500, 2000, 3000] {
            let folder = Folder::with(&text);
            let mut kills = 0;
            loop {
                let mut run = folder.command_of(
                    env!("CARGO_BIN_EXE_jitai"),
                    ["run", "sweep.toml", "--workers", "1", "--quiet"],
                );
                run.stdout(Stdio::null()).stderr(Stdio::null());
                let mut process = Process(run.spawn().unwrap());
                if let Some(ended) = process.ends_within(Duration::from_millis(milliseconds)) {
                    assert_eq!(ended.code(), Some(0), "{name} after {kills} kills");
                    break;
                }
                process.0.kill().unwrap();
                assert_eq!(process.end().signal(), Some(SIGKILL));
                kills += 1;
                assert!(kills <= MOST_KILLS, "{name} got no further in {kills} kills");
            }
            println!("{name}, {took:?} undisturbed, killed every {milliseconds} ms: {kills} kills");
            assert_eq!(folder.dump(), rows, "{name} killed every {milliseconds} ms");
        }
    }
}
