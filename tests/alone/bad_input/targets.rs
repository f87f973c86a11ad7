//! The readers of outside bytes, one function per reader. Each function takes arbitrary bytes, and
//! panics if the reader panics or breaks a promise.
//!
//! The functions are fuzzed (`fuzz/`) and run on their corpus (`tests/alone/bad_input.rs`). The caller
//! watches time and memory.

use std::cell::RefCell;
use std::fs;
use std::io::{Cursor, Write};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, OnceLock};
use std::time::{Duration, Instant, SystemTime};
use std::{str, thread};

use jitai::agent::{Actions, Weights};
use jitai::cli::input;
use jitai::env::{Action, LaneSet, LaneStreams, VectorEnvironment};
use jitai::job::Job;
use jitai::job::{CurvePoint, Outcome, Provenance};
use jitai::manifest::{self, Manifest};
use jitai::plan::{self};
use jitai::rng::{Purpose, Stream};
use jitai::store::{
    self, Answer, Claimed, Experiment, Interrupter, Isolation, Parts, QueryError, Reader,
    RetryFailed, Store,
};
use jitai::train::{
    self, CheckpointError, Checkpoints, ReadCheckpoint, TrainingControl, TrainingProgress,
    Uncontrolled, WriteCheckpoint,
};
use sha2::{Digest, Sha256};
use tempfile::TempDir;

/// A target: a reader of bytes.
pub type Target = fn(&[u8]);

/// Every target, with its name.
pub const TARGETS: [(&str, Target); 7] = [
    ("manifest", manifest),
    ("model", model),
    ("query", query),
    ("filter", filter),
    ("replay", replay),
    ("checkpoint", checkpoint),
    ("store", store),
];

/// Maximum number of jobs created from a grid; a valid manifest may ask for millions.
const JOBS_MADE: usize = 200;
/// Maximum number of jobs of a manifest that is also tested in its resolved form.
const MOST_RESOLVED: u64 = 10_000;
/// Number of decisions that are taken in a model.
const DECISIONS_TAKEN: usize = 20;
/// Maximum number of rows read from an answer.
const ROWS_HEARD: usize = 1_000;
/// Time limit of a query. Outside tests there is no limit, and people stop long queries.
const PATIENCE: Duration = Duration::from_millis(200);

/// `check` and `plan`: a manifest is rejected with faults, or its resolved form makes the same jobs.
pub fn manifest(bytes: &[u8]) {
    let manifest = match manifest::parse("fuzzed", bytes) {
        Ok(manifest) => manifest,
        Err(faults) => return assert!(!faults.to_string().is_empty()),
    };
    let count = plan::count(&manifest);
    assert!((1..=manifest::MOST_JOBS).contains(&count));
    let keys = |manifest: &Manifest| -> Vec<_> {
        plan::jobs(manifest).take(JOBS_MADE).map(|planned| planned.form.key()).collect()
    };
    let planned = keys(&manifest);
    assert_eq!(planned.len() as u64, count.min(JOBS_MADE as u64));
    if count <= MOST_RESOLVED {
        let resolved = manifest.resolved();
        let again = manifest::parse("resolved", resolved.as_bytes())
            .unwrap_or_else(|faults| panic!("{faults}\n{resolved}"));
        assert_eq!(keys(&again), planned);
    }
}

/// A model: it is rejected with faults, or it is simulated, or says why it cannot go on.
pub fn model(bytes: &[u8]) {
    thread_local! {
        static FOLDER: TempDir = tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir()).unwrap();
    }
    let path = FOLDER.with(|folder| folder.path().join("model.toml"));
    fs::write(&path, bytes).unwrap();
    let text = format!(
        "format = 1\nname = \"fuzzed\"\nscenarios = \"all\"\nseeds = 1\n[environment]\nfamily = \"declared\"\n\
         model = {path:?}\n[[agent]]\nname = \"rule\"\nalgorithm = \"rule\"\nrule = \"random\"\n"
    );
    let manifest = match manifest::parse("fuzzed", text.as_bytes()) {
        Ok(manifest) => manifest,
        Err(faults) => return assert!(!faults.to_string().is_empty()),
    };
    let job = plan::jobs(&manifest).next().unwrap().job;
    let mut lanes = job.environment.testing(&job.scenario, 1, 2);
    let mut streams = LaneStreams::Shared(Stream::new(1, Purpose::Environment));
    lanes.reset(LaneSet::All, &mut streams);
    let mut rewards = [0.0; 2];
    for _ in 0..DECISIONS_TAKEN {
        let actions = [Action::default(), Action::from_index(1).unwrap()];
        lanes.step(&actions, &mut rewards, &mut streams);
        let is_sound = rewards.iter().all(|reward| reward.is_finite());
        assert!(is_sound && job.environment.failure().is_none_or(|says| !says.is_empty()));
    }
}

/// `query`: any SQL leaves the store and its folder unchanged.
pub fn query(bytes: &[u8]) {
    thread_local! {
        static ASKED: RefCell<Option<Asked>> = const { RefCell::new(None) };
    }
    let Ok(sql) = str::from_utf8(bytes) else { return };
    ASKED.with_borrow_mut(|asked| {
        let open = asked.take().unwrap_or_else(Asked::new);
        *asked = open.ask(sql);
    });
}

/// Queries of one open store, because opening takes longer than most queries.
struct Asked {
    place: TempDir,
    reader: Reader,
    listed: Vec<PathBuf>,
    seen: Seen,
    queries: u32,
}

/// The signs of a write to a file: its length and its modification time.
type Seen = (u64, SystemTime);

impl Asked {
    /// Number of queries after which a store is opened again.
    const MOST: u32 = 1000;

    fn new() -> Asked {
        let place = folder_with(template());
        let reader = Reader::open(&place.path().join("jitai.sqlite")).unwrap();
        let (listed, seen) = (listing(place.path()), seen(place.path()));
        Asked { place, reader, listed, seen, queries: 0 }
    }

    /// Runs a query; returns itself for the next query, or `None` after [`Asked::MOST`] queries.
    fn ask(mut self, sql: &str) -> Option<Asked> {
        let mut rows = 0;
        let hear = |_: Answer<'_>| {
            rows += 1;
            if rows > ROWS_HEARD { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        };
        match patiently(&self.reader, || self.reader.query(sql, hear)) {
            Ok(()) => {}
            Err(QueryError::Damaged { reason }) => panic!("a query damaged the store: {reason}"),
            Err(error) => assert!(!error.to_string().is_empty()),
        }
        assert_eq!(listing(self.place.path()), self.listed, "{sql}");
        assert_eq!(seen(self.place.path()), self.seen, "{sql}");
        self.queries += 1;
        if self.queries < Asked::MOST {
            return Some(self);
        }
        let Asked { place, reader, .. } = self;
        drop(reader);
        assert!(fs::read(place.path().join("jitai.sqlite")).unwrap() == template());
        None
    }
}

/// The length and modification time of the store in a folder.
fn seen(folder: &Path) -> Seen {
    let metadata = fs::metadata(folder.join("jitai.sqlite")).unwrap();
    (metadata.len(), metadata.modified().unwrap())
}

/// `--filter`: the filter matches jobs, or the error says why not.
pub fn filter(bytes: &[u8]) {
    static MANIFESTS: OnceLock<[Manifest; 1]> = OnceLock::new();
    let Ok(text) = str::from_utf8(bytes) else { return };
    let manifests = MANIFESTS.get_or_init(|| [declared()]);
    match input::filtered(text, manifests) {
        Ok(jobs) => assert!((1..=plan::expand(&manifests[0]).len()).contains(&jobs)),
        Err(message) => assert!(!message.is_empty()),
    }
}

/// `simulate --replay`: the trajectories can be replayed, or the error says why not.
pub fn replay(bytes: &[u8]) {
    if let Err(message) = input::replayed(bytes) {
        assert!(!message.is_empty());
    }
}

/// Resumption from a checkpoint. The first byte chooses the job, and whether the rest is a whole file
/// or the state in an otherwise valid file: no mutation would find the right hash.
pub fn checkpoint(bytes: &[u8]) {
    static SOUND: OnceLock<Vec<(Job, Vec<u8>)>> = OnceLock::new();
    let Some((choice, rest)) = bytes.split_first() else { return };
    let sound = SOUND.get_or_init(|| {
        plan::jobs(&declared())
            .map(|planned| (sound_checkpoint(&planned.job), planned.job))
            .map(|(file, job)| (job, file))
            .collect()
    });
    let (job, file) = &sound[usize::from(choice / 2) % sound.len()];
    let shown = if choice % 2 == 0 { rest.to_vec() } else { with_state(file, rest) };
    let shelf = Shelf { shown: Some(shown), ..Shelf::default() };
    assert_eq!(train::run(job, &shelf), Outcome::Interrupted);
    // Whether the checkpoint was accepted or not, the training leaves a checkpoint from which the job
    // resumes.
    let kept = shelf.kept.into_inner().expect("a stopped training leaves a checkpoint");
    let shelf = Shelf { shown: Some(kept), ..Shelf::default() };
    assert_eq!(train::run(job, &shelf), Outcome::Interrupted);
    let refused = shelf.refused.into_inner();
    assert!(refused.is_none(), "{refused:?}");
}

/// A store from an untrusted source. The first byte chooses whether the rest is the whole file or a
/// list of changes to a valid file, each with an offset of four bytes, a length of one byte, and the
/// new bytes.
pub fn store(bytes: &[u8]) {
    let Some((choice, rest)) = bytes.split_first() else { return };
    let file = if choice % 2 == 0 { rest.to_vec() } else { changed(template(), rest) };
    let place = folder_with(&file);
    let path = place.path().join("jitai.sqlite");
    if let Ok(reader) = Reader::open(&path) {
        let hear = |_: Answer<'_>| ControlFlow::Continue(());
        patiently(&reader, || {
            for view in store::VIEWS {
                let _ = reader.query(&format!("SELECT * FROM {view} LIMIT {ROWS_HEARD}"), hear);
            }
        });
        let _ = reader.experiment_counts();
        let _ = reader.failed_jobs();
        let _ = reader.paces();
        let _ = reader.manifest("fuzzed");
        let parts =
            Parts { curve: true, actions: true, returns: true, estimates: true, posteriors: true };
        let _ = reader.data_set_of("fuzzed", plan::jobs(&declared()), |_| parts, |_| ());
    }
    match store::examine(&path, &check_weights) {
        Ok(diagnosis) => assert!(diagnosis.intact <= diagnosis.completed),
        Err(error) => assert!(!error.to_string().is_empty()),
    }
    // Readers never write.
    assert!(fs::read(&path).unwrap() == file);
    let new = place.path().join("new.sqlite");
    if store::salvage(&path, &new, &check_weights).is_ok() {
        let diagnosis = store::examine(&new, &check_weights).unwrap();
        assert_eq!(diagnosis.findings, [], "salvage keeps what is intact alone");
    }
}

/// A manifest with every kind of value, whose jobs take milliseconds.
pub fn declared() -> Manifest {
    let text = "format = 1
name = \"fuzzed\"
scenarios = [\"P-H-D\", \"L-T\"]
seeds = 1
[environment]
sigma = [0.4, 0.6]
horizon = 5
[evaluation]
test_episodes = 2
[[agent]]
name = \"dqn\"
algorithm = \"dueling_dqn\"
episodes = 4
layers = [4, 2]
batch = 4
buffer = 9
[[agent]]
name = \"reinforce, \\\"plain\\\"\"
algorithm = \"reinforce\"
episodes = 4
layers = [4]
[[agent]]
name = \"rule\"
algorithm = \"rule\"
rule = \"tailored\"
";
    manifest::parse("declared", text.as_bytes()).unwrap_or_else(|faults| panic!("{faults}"))
}

/// The bytes of a store in which the jobs of [`declared`] are completed.
pub fn template() -> &'static [u8] {
    static BYTES: OnceLock<Vec<u8>> = OnceLock::new();
    BYTES.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("jitai.sqlite");
        fill(&path);
        fs::read(path).unwrap()
    })
}

fn fill(path: &Path) {
    let manifest = declared();
    let jobs: Vec<_> = plan::jobs(&manifest).collect();
    let mut store = Store::open(path).unwrap();
    let word = || "fuzzed".to_owned();
    let provenance = Provenance {
        code_version: word(),
        git_revision: word(),
        backend: word(),
        host: store::host_name(),
        processor: word(),
    };
    let session = store.begin_session(&provenance).unwrap();
    let experiment = Experiment {
        name: &manifest.name,
        question: None,
        hypothesis: None,
        manifest: &manifest.source,
    };
    store.register(&experiment, jobs.iter().map(|planned| (&planned.agent, &planned.job))).unwrap();
    for planned in &jobs {
        let key = planned.job.key();
        let claim = match store.claim(session, &key, RetryFailed::No, Isolation::Shared).unwrap() {
            Claimed::Claimed(claim) => claim,
            other => panic!("the job is not free: {other:?}"),
        };
        store.finish(&claim, &train::run(&planned.job, &Uncontrolled), 0.5).unwrap();
    }
    store.end_session(session).unwrap();
}

/// A folder with these bytes as `jitai.sqlite`; in memory if the system supports that.
fn folder_with(bytes: &[u8]) -> TempDir {
    let folder = tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir()).unwrap();
    fs::write(folder.path().join("jitai.sqlite"), bytes).unwrap();
    folder
}

/// The names in a folder, without the files that readers and writers of a store share.
fn listing(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let shared = |path: &PathBuf| path.extension().is_some_and(|end| end != "sqlite");
    let mut names: Vec<_> = entries.filter(|path| !shared(path)).collect();
    names.sort();
    names
}

/// The state of the watching thread: for each reader at work, its start and its interrupter.
type Watched = Mutex<Vec<(Instant, Arc<Interrupter>)>>;

/// Runs `work`; interrupts the reader if the work takes too long.
fn patiently<T>(reader: &Reader, work: impl FnOnce() -> T) -> T {
    static WATCHED: OnceLock<Arc<Watched>> = OnceLock::new();
    let watched = WATCHED.get_or_init(|| {
        let watched: Arc<Watched> = Arc::default();
        let theirs = watched.clone();
        // The thread lives as long as the process: starting one per query would take longer than most
        // queries.
        thread::spawn(move || watch(&theirs));
        watched
    });
    let interrupter = Arc::new(reader.interrupter());
    watched.lock().unwrap().push((Instant::now(), interrupter.clone()));
    let result = work();
    watched.lock().unwrap().retain(|(_, other)| !Arc::ptr_eq(other, &interrupter));
    result
}

fn watch(watched: &Watched) {
    loop {
        thread::sleep(PATIENCE / 20);
        // The interrupt is repeated, because it does not affect a query that begins after it.
        for (begun, interrupter) in watched.lock().unwrap().iter() {
            if begun.elapsed() >= PATIENCE {
                interrupter.interrupt();
            }
        }
    }
}

/// Bytes with changes applied, in the format of [`store`].
fn changed(sound: &[u8], mut changes: &[u8]) -> Vec<u8> {
    let mut bytes = sound.to_vec();
    while let Some(([a, b, c, d, length], rest)) = changes.split_first_chunk() {
        let offset = u32::from_le_bytes([*a, *b, *c, *d]) as usize % bytes.len();
        let (new, rest) = rest.split_at(rest.len().min(usize::from(*length)));
        let room = new.len().min(bytes.len() - offset);
        bytes[offset..offset + room].copy_from_slice(&new[..room]);
        changes = rest;
    }
    bytes
}

fn check_weights(job: &Job, safetensors: Option<&[u8]>) -> Result<(), String> {
    let safetensors = safetensors.ok_or("no weights are stored")?;
    let weights = Weights::from_bytes(safetensors).map_err(|error| error.to_string())?;
    job.agent
        .trained(&job.task(), &weights, Actions::AsTrained)
        .map(|_| ())
        .map_err(|error| error.to_string())
}

/// A checkpoint of a job that was stopped immediately.
pub fn sound_checkpoint(job: &Job) -> Vec<u8> {
    let shelf = Shelf::default();
    assert_eq!(train::run(job, &shelf), Outcome::Interrupted);
    shelf.kept.into_inner().expect("a stopped training leaves a checkpoint")
}

/// The state in a checkpoint: the bytes between its two lines and its hash.
pub fn state(file: &[u8]) -> &[u8] {
    let lines = file.split_inclusive(|byte| *byte == b'\n').take(2);
    &file[lines.map(<[u8]>::len).sum()..file.len() - 32]
}

fn with_state(file: &[u8], new: &[u8]) -> Vec<u8> {
    let mut bytes = file[..file.len() - 32 - state(file).len()].to_vec();
    bytes.extend_from_slice(new);
    let seal = Sha256::digest(&bytes);
    bytes.extend_from_slice(&seal);
    bytes
}

/// A keeper that offers one checkpoint to a training, stops it, and keeps the checkpoint that it
/// writes.
#[derive(Default)]
struct Shelf {
    shown: Option<Vec<u8>>,
    refused: RefCell<Option<CheckpointError>>,
    kept: RefCell<Option<Vec<u8>>>,
}

impl Checkpoints for Shelf {
    fn are_due(&self) -> bool {
        false
    }

    fn resume(&self, read: &mut ReadCheckpoint<'_>) {
        if let Some(shown) = &self.shown {
            *self.refused.borrow_mut() = read(&mut Cursor::new(shown)).err();
        }
    }

    fn keep(&self, write: &mut WriteCheckpoint<'_>) {
        let mut kept = Vec::new();
        write(&mut kept as &mut dyn Write).unwrap();
        *self.kept.borrow_mut() = Some(kept);
    }
}

impl TrainingControl for Shelf {
    fn report(&self, _: TrainingProgress, _: &[CurvePoint]) {}

    fn stop_requested(&self) -> bool {
        true
    }

    fn worked(&self) -> Duration {
        Duration::ZERO
    }

    fn checkpoints(&self) -> &dyn Checkpoints {
        self
    }
}
