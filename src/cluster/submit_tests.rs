//! Tests of submission with a fake engine that gives scripted answers.

use std::cell::RefCell;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use super::attempt::{AttemptEnd, TaskAttempt};
use super::engine::{Alive, Engine, EngineError, Limits, TaskPhase};
use super::error::ClusterError;
use super::folder::{HandedIn, Stop, Submission};
use super::profile::Profile;
use super::submit::{Cluster, Request, SubmissionDraft};
use super::task::{TaskEnd, TaskOrder, run_chunk};
use crate::job::JobKey;
use crate::manifest::{self, Manifest};
use crate::schedule::Selection;
use crate::store::{JobState, Reader, RetryFailed, Store};

/// The response of the engine to an array.
#[derive(Clone, Copy, PartialEq)]
enum Answer {
    Accepts,
    Refuses,
    /// The engine accepts the array but reports a rejection.
    Loses,
    /// The process is killed before it calls the engine.
    IsNotCalled,
}

/// A fake engine with scripted answers.
struct Fake {
    answer: RefCell<Answer>,
    alive: RefCell<Result<Vec<Alive>, ()>>,
    submitted: RefCell<Vec<String>>,
}

impl Fake {
    fn new() -> Fake {
        Fake {
            answer: RefCell::new(Answer::Accepts),
            alive: RefCell::new(Ok(Vec::new())),
            submitted: RefCell::new(Vec::new()),
        }
    }

    /// Makes the engine hold the first chunks of the last array that it accepted.
    fn hold(&self, chunks: u32, phase: TaskPhase) {
        let name = self.submitted.borrow().last().unwrap().clone();
        let task = |chunk| Alive { name: name.clone(), array: "17".to_owned(), chunk, phase };
        *self.alive.borrow_mut() = Ok((0..chunks).map(task).collect());
    }

    fn refused() -> EngineError {
        EngineError::Refused { program: "sbatch", words: "no".to_owned() }
    }
}

impl Engine for &Fake {
    fn submit(&self, script: &Path) -> Result<String, EngineError> {
        let text = fs::read_to_string(script).unwrap();
        let name = text.lines().find_map(|line| line.strip_prefix("#SBATCH --job-name="));
        let name = name.unwrap().to_owned();
        let answer = *self.answer.borrow();
        match answer {
            Answer::Accepts | Answer::Loses => {
                self.submitted.borrow_mut().push(name);
                self.hold(1000, TaskPhase::Waiting);
            }
            Answer::Refuses => {}
            Answer::IsNotCalled => {
                return Err(EngineError::Missing {
                    engine: "Slurm",
                    program: "sbatch",
                    source: io::Error::other(""),
                });
            }
        }
        if answer == Answer::Accepts { Ok("17".to_owned()) } else { Err(Fake::refused()) }
    }

    fn alive(&self, names: &[&str]) -> Result<Vec<Alive>, EngineError> {
        let alive = self.alive.borrow().clone().map_err(|()| Fake::refused())?;
        Ok(alive.into_iter().filter(|task| names.contains(&task.name.as_str())).collect())
    }

    fn cancel(&self, _: &str) -> Result<(), EngineError> {
        *self.alive.borrow_mut() = Ok(Vec::new());
        Ok(())
    }

    fn limits(&self) -> Result<Limits, EngineError> {
        Ok(Limits { most_tasks: 1001 })
    }
}

/// A store with the 20 registered jobs of a manifest, none of which has run.
struct Lab {
    manifests: Vec<Manifest>,
    profile: Profile,
    store: PathBuf,
    engine: Fake,
    folder: tempfile::TempDir,
}

impl Lab {
    fn new() -> Lab {
        Lab::of("[[agent]]\nname = \"never\"\nalgorithm = \"rule\"\nrule = \"never\"\n")
    }

    fn of(agents: &str) -> Lab {
        Lab::with(agents, &[])
    }

    /// A lab whose manifest lies beside these files.
    fn with(agents: &str, files: &[(&str, &str)]) -> Lab {
        let text = format!(
            "format = 1\nname = \"t\"\nscenarios = [\"P\"]\nseeds = 20\n\
             environment.sigma = 0.6\nevaluation.test_episodes = 1\n{agents}"
        );
        let folder = tempfile::tempdir().unwrap();
        for (name, text) in files {
            fs::write(folder.path().join(name), text).unwrap();
        }
        let path = folder.path().join("t.toml").display().to_string();
        fs::write(&path, &text).unwrap();
        let manifests = vec![manifest::load(Path::new(&path)).unwrap()];
        let store = folder.path().join("s.sqlite");
        let never = AtomicBool::new(false);
        let mut opened = Store::open(&store).unwrap();
        let selection = Selection::new(&manifests, None).unwrap();
        assert!(
            crate::schedule::register(&mut opened, &selection, &never, |_| {})
                .unwrap()
                .is_continue()
        );
        // Four jobs per chunk, at an estimate of about 1 ms per job.
        let mut profile = Profile::default();
        profile.tasks.chunk_minutes = 0.0044 / 60.0;
        Lab { manifests, profile, store, engine: Fake::new(), folder }
    }

    fn cluster(&self) -> Cluster<'_> {
        let cluster = Cluster::of(&self.store, |_| Box::new(&self.engine)).unwrap();
        cluster.submissions().make(None).unwrap();
        cluster
    }

    fn with_request<T>(&self, act: impl FnOnce(Request<'_>) -> T) -> T {
        let selection = Selection::new(&self.manifests, None).unwrap();
        let program = Path::new("/bin/jitai");
        let (retry, profile) = (RetryFailed::No, &self.profile);
        act(Request { selection: &selection, retry, profile, program })
    }

    /// The draft of the next submission.
    fn draft(&self) -> SubmissionDraft {
        let cluster = self.cluster();
        let look = cluster.look().unwrap();
        let reader = Reader::open(&self.store).unwrap();
        let limits = cluster.limits(self.profile.engine).unwrap();
        self.with_request(|request| cluster.draft(request, Some(&reader), &look, limits).unwrap())
    }

    fn launch(&self) -> Result<Submission, ClusterError> {
        let draft = self.draft();
        self.with_request(|request| self.cluster().launch(&draft, request))
    }

    /// Records an attempt at a chunk that ended in this way, or that has not ended.
    fn attempt(&self, submission: &Submission, chunk: u32, end: Option<AttemptEnd>) {
        let name = format!("1.{}", submission.attempts().unwrap().len());
        let attempt = TaskAttempt { end, ..TaskAttempt::begin(chunk, name, "n1".to_owned(), 1) };
        submission.record_attempt(&attempt).unwrap();
    }
}

fn sizes(draft: &SubmissionDraft) -> Vec<usize> {
    draft.chunks.iter().map(|chunk| chunk.keys.len()).collect()
}

#[test]
fn what_the_engine_holds_is_not_submitted_again() {
    let lab = Lab::new();
    assert_eq!(sizes(&lab.draft()), [4; 5]);
    let submission = lab.launch().unwrap();
    assert_eq!(submission.array().as_deref(), Some("17"));
    let draft = lab.draft();
    assert_eq!((draft.jobs(), draft.held), (0, 20));
    lab.engine.hold(2, TaskPhase::Running);
    let draft = lab.draft();
    assert_eq!((draft.jobs(), draft.held), (12, 8));
    // The experiment may still get results, until its tasks have ended.
    let count_open = |name| lab.cluster().look().unwrap().open(name).count();
    let name = &lab.manifests[0].name;
    assert_eq!((count_open(name), count_open("another")), (1, 0));
    submission.stop(Stop::Cancelled).unwrap();
    assert_eq!(count_open(name), 0);
}

#[test]
fn silence_holds_every_job_that_was_not_handed_in() {
    let lab = Lab::new();
    lab.launch().unwrap();
    *lab.engine.alive.borrow_mut() = Err(());
    let draft = lab.draft();
    assert_eq!((draft.jobs(), draft.held), (0, 20));
    let look = lab.cluster().look().unwrap();
    assert!(look.silence.is_some());
    assert_eq!(look.surveys[0].1.counts().unknown, 5);
}

#[test]
fn a_refused_array_leaves_no_submission() {
    let lab = Lab::new();
    *lab.engine.answer.borrow_mut() = Answer::Refuses;
    let error = lab.launch().unwrap_err();
    assert_eq!(error.to_string(), "`sbatch` failed: no");
    assert!(lab.cluster().submissions().list().unwrap().is_empty());
}

#[test]
fn an_array_that_was_accepted_without_an_answer_is_found_by_its_name() {
    let lab = Lab::new();
    *lab.engine.answer.borrow_mut() = Answer::Loses;
    assert_eq!(lab.launch().unwrap().array().as_deref(), Some("17"));
    assert_eq!(lab.engine.submitted.borrow().len(), 1);
}

#[test]
fn an_intent_whose_array_is_alive_is_completed_and_one_without_is_abandoned() {
    let lab = Lab::new();
    let submission = lab.launch().unwrap();
    fs::remove_file(submission.path().join("array")).unwrap();
    let mut look = lab.cluster().look().unwrap();
    assert_eq!(submission.array().as_deref(), Some("17"));
    assert!(lab.cluster().abandon_unknown(&mut look).unwrap().is_empty());

    fs::remove_file(submission.path().join("array")).unwrap();
    *lab.engine.alive.borrow_mut() = Ok(Vec::new());
    let mut look = lab.cluster().look().unwrap();
    assert_eq!(lab.cluster().abandon_unknown(&mut look).unwrap(), [submission.name()]);
    assert_eq!(submission.stopped(), Some(Stop::Abandoned));
    assert_eq!(lab.draft().jobs(), 20);
}

#[test]
fn an_intent_whose_tasks_have_run_is_not_abandoned() {
    let lab = Lab::new();
    let submission = lab.launch().unwrap();
    fs::remove_file(submission.path().join("array")).unwrap();
    lab.attempt(&submission, 0, Some(AttemptEnd::Stopped));
    *lab.engine.alive.borrow_mut() = Ok(Vec::new());
    let mut look = lab.cluster().look().unwrap();
    assert!(lab.cluster().abandon_unknown(&mut look).unwrap().is_empty());
}

/// An outside program that trains in no episode and always sends an untailored message.
const PROGRAM: &str = r#"
read -r line
echo '{"type":"ready","protocol":1}'
echo '{"type":"trained"}'
while read -r line; do
  case $line in *'"type":"act"'*) echo '{"type":"choices","actions":[1]}';; esac
done
"#;

#[test]
fn a_task_starts_outside_programs_in_the_folder_of_their_manifest() {
    let lab = Lab::of(
        "[[agent]]\nname = \"outside\"\nalgorithm = \"external\"\nepisodes = 1\n\
         command = [\"sh\", \"program.sh\"]\nversion = \"1\"\n",
    );
    fs::write(lab.folder.path().join("program.sh"), PROGRAM).unwrap();
    let submission = lab.launch().unwrap();
    let chunks = submission.intent.chunks;
    assert!(chunks > 1, "{chunks}");
    let scratch = tempfile::tempdir().unwrap();
    for chunk in 0..chunks {
        let (scratch, stop) = (scratch.path(), &AtomicBool::new(false));
        let assignment = TaskOrder { submission: &submission, chunk, attempt: "1", scratch, stop };
        let mut log = Vec::new();
        let end = run_chunk(assignment, &mut log).unwrap();
        assert_eq!(end, TaskEnd::Finished, "{}", String::from_utf8_lossy(&log));
    }
    let look = lab.cluster().look().unwrap();
    let survey = &look.surveys[0].1;
    assert!(survey.chunks.iter().all(|chunk| chunk.left.is_empty()));
    let parts = submission.parts().unwrap();
    let jobs: Vec<(JobKey, HandedIn)> =
        parts.iter().filter_map(|part| part.jobs()).flatten().collect();
    assert_eq!(jobs.len(), 20);
    assert!(jobs.iter().all(|(_, end)| *end == HandedIn::Completed), "{jobs:?}");
}

#[test]
fn a_submission_holds_the_files_of_its_manifests() {
    let agents = "[[agent]]\nname = \"never\"\nalgorithm = \"rule\"\nrule = \"never\"\n";
    let rows = "[population]\nrows = \"people.csv\"\n";
    let files = [("people.csv", "epsilon_d\n0.1\n0.3\n")];
    let lab = Lab::with(&format!("{rows}{agents}"), &files);
    let submission = lab.launch().unwrap();
    // The file can change, and nodes need not see it.
    fs::remove_file(lab.folder.path().join("people.csv")).unwrap();
    let (scratch, stop) = (tempfile::tempdir().unwrap(), &AtomicBool::new(false));
    let scratch = scratch.path();
    let assignment = TaskOrder { submission: &submission, chunk: 0, attempt: "1", scratch, stop };
    let mut log = Vec::new();
    let end = run_chunk(assignment, &mut log).unwrap();
    assert_eq!(end, TaskEnd::Finished, "{}", String::from_utf8_lossy(&log));
    assert!(submission.parts().unwrap()[0].jobs().unwrap().len() > 1);
}

#[test]
fn jobs_that_were_handed_in_are_not_left() {
    let lab = Lab::new();
    let submission = lab.launch().unwrap();
    let keys = submission.chunk(0).unwrap();
    let jobs: Vec<(JobKey, HandedIn)> =
        keys[..3].iter().map(|key| (*key, HandedIn::Completed)).collect();
    submission.hand_in("0.1.0-1", &lab.store, &jobs).unwrap();
    lab.engine.hold(5, TaskPhase::Running);
    let look = lab.cluster().look().unwrap();
    assert_eq!(look.surveys[0].1.chunks[0].left, &keys[3..]);
    assert_eq!(look.surveys[0].1.held().count(), 17);
}

#[test]
fn a_job_that_brings_down_three_tasks_fails_and_can_be_tried_again() {
    let lab = Lab::new();
    let mut killer: Option<JobKey> = None;
    for sizes_expected in [&[4, 4, 4, 4, 4][..], &[16, 1, 1, 1, 1], &[16, 1, 1, 1, 1]] {
        let submission = lab.launch().unwrap();
        let chunks: Vec<Vec<JobKey>> =
            (0..submission.intent.chunks).map(|chunk| submission.chunk(chunk).unwrap()).collect();
        let killer = *killer.get_or_insert(chunks[0][0]);
        let index = chunks.iter().position(|chunk| chunk.contains(&killer)).unwrap();
        lab.attempt(&submission, index as u32, None);
        // The task with the killer died, and no other task had started.
        *lab.engine.alive.borrow_mut() = Ok(Vec::new());
        let largest = chunks.iter().map(Vec::len).max().unwrap();
        assert!(largest <= sizes_expected[0].max(4), "{chunks:?}");
    }
    let killer = killer.unwrap();
    let mut store = Store::open(&lab.store).unwrap();
    let look = lab.cluster().look().unwrap();
    assert_eq!(lab.cluster().record_crashes(&look, &mut store).unwrap(), [killer]);
    let reader = Reader::open(&lab.store).unwrap();
    assert_eq!(reader.job_states([&killer]).unwrap(), [JobState::Failed]);
    let draft = lab.draft();
    assert_eq!((draft.failed, draft.jobs()), (1, 19));
    // A recorded crash is not recorded again.
    assert!(lab.cluster().record_crashes(&look, &mut store).unwrap().is_empty());
}

#[test]
fn tasks_that_are_stopped_or_say_why_they_fail_are_no_deaths() {
    let lab = Lab::new();
    for end in [AttemptEnd::Stopped, AttemptEnd::Failed("full".to_owned()), AttemptEnd::Stopped] {
        let submission = lab.launch().unwrap();
        lab.attempt(&submission, 0, Some(end));
        *lab.engine.alive.borrow_mut() = Ok(Vec::new());
    }
    assert_eq!(sizes(&lab.draft()), [4; 5]);
}

#[test]
fn a_cancelled_submission_holds_nothing() {
    let lab = Lab::new();
    let submission = lab.launch().unwrap();
    lab.attempt(&submission, 0, None);
    lab.cluster().cancel(&submission).unwrap();
    assert_eq!(submission.stopped(), Some(Stop::Cancelled));
    assert_eq!(sizes(&lab.draft()), [4; 5]);
}

#[test]
fn a_missing_program_leaves_no_submission() {
    let lab = Lab::new();
    *lab.engine.answer.borrow_mut() = Answer::IsNotCalled;
    assert!(lab.launch().unwrap_err().to_string().contains("a command of Slurm"));
    assert!(lab.cluster().submissions().list().unwrap().is_empty());
}
