//! Damaged stores: nothing panics, `doctor` detects every change of an answer, and intact runs can be
//! saved.

use std::collections::HashSet;
use std::env;
use std::fs;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use crate::failures::partly_diverging;
use crate::support::{Effort, Finished, Folder, assert_same_rows, manifest};

/// Number of places in a store at which a byte is changed; `JITAI_DAMAGED_PLACES` overrides it.
const PLACES: usize = 20;

/// Seed of the places and of the changes.
const SEED: u64 = 7;

const VIEWS: [&str; 5] =
    ["parameter", "metric", "learning_curve", "evaluation_episode", "action_choice"];

/// A folder whose store has completed runs of two agents, and failed runs.
fn healthy() -> Folder {
    let folder = Folder::with(&manifest("sweep", "[0.4, 0.6]", "3", Effort::Trivial));
    folder.write("wild.toml", partly_diverging().replace("\"sweep\"", "\"wild\""));
    folder.jitai(["run", "sweep.toml", "wild.toml", "--quiet"]).ended(1);
    folder.jitai(["doctor"]).succeeded().prints("is healthy: 14 completed runs");
    folder
}

fn store(folder: &Folder) -> Vec<u8> {
    // A reader may leave a log, but only an empty one.
    let log = fs::metadata(folder.path("jitai.sqlite-wal")).map_or(0, |log| log.len());
    assert_eq!(log, 0);
    fs::read(folder.path("jitai.sqlite")).unwrap()
}

/// A folder with the manifests of another folder, and these bytes as its store.
fn with_store(of: &Folder, bytes: &[u8]) -> Folder {
    let folder = Folder::with(&of.read("sweep.toml"));
    folder.write("wild.toml", of.read("wild.toml"));
    folder.write("jitai.sqlite", bytes);
    folder
}

/// The answers of commands.
#[derive(Debug)]
struct Answers {
    /// Whether `doctor` found the store healthy.
    healthy: bool,
    /// The name and the answer of every command that answered.
    given: Vec<(String, String)>,
}

/// Runs every reading command, and asserts that it answers or reports what is wrong.
fn ask(folder: &Folder, place: &str) -> Answers {
    let mut given = Vec::new();
    let mut hear = |name: String, finished: Finished, codes: &[i32]| {
        let code = finished.code.unwrap_or(-1);
        let told = &finished.stderr;
        assert!(codes.contains(&code), "{place}: {name} ended with {code}: {told}");
        assert!(!told.contains("panicked at"), "{place}: {name}: {told}");
        if code == 0 {
            given.push((name, finished.stdout));
        } else {
            assert!(told.contains("error: "), "{place}: {name} says nothing: {told:?}");
        }
    };
    let status = folder.jitai(["status", "--format", "json"]);
    hear("status".to_owned(), status, &[0, 3]);
    hear("plan".to_owned(), folder.jitai(["plan", "sweep.toml", "--jobs"]), &[0, 3]);
    let summary = "SELECT experiment, job_key, agent, scenario, sigma, seed, status, mean_return,
        sd_return, mean_length, disengagement_rate, failure_kind, failure_message
        FROM run_summary ORDER BY 1, 2, 3, attempt";
    // SQLite treats a damaged text as a faulty argument of an SQL function.
    hear("query".to_owned(), folder.jitai(["query", "--format", "csv", summary]), &[0, 2, 3]);
    let exported = folder.jitai(["export", "--out", "out"]);
    let whole = exported.code == Some(0);
    hear("export".to_owned(), Finished { stdout: String::new(), ..exported }, &[0, 2, 3]);
    if whole {
        let files = VIEWS.map(|view| (view.to_owned(), folder.read(&format!("out/{view}.csv"))));
        given.extend(files);
    }
    let doctor = folder.jitai(["doctor"]);
    assert!(matches!(doctor.code, Some(0 | 3)), "{place}: {doctor:?}");
    assert!(!doctor.stderr.contains("panicked at"), "{place}: {doctor:?}");
    let said = doctor.stdout.contains("damaged") || doctor.stderr.contains("error: ");
    assert!(doctor.code == Some(0) || said, "{place}: {doctor:?}");
    let lines: HashSet<&str> = doctor.stdout.lines().collect();
    assert_eq!(lines.len(), doctor.stdout.lines().count(), "{place}: twice in {}", doctor.stdout);
    assert!(!doctor.stdout.contains("\\n"), "{place}: lines in a line of {}", doctor.stdout);
    Answers { healthy: doctor.code == Some(0), given }
}

/// The first ten lines of these answers that occur in no expected answer.
fn new_lines<'a>(answers: &[&'a (String, String)], expected: &[(String, String)]) -> Vec<&'a str> {
    let known: HashSet<&str> = expected.iter().flat_map(|(_, answer)| answer.lines()).collect();
    let lines = answers.iter().flat_map(|(_, answer)| answer.lines());
    lines.filter(|line| !known.contains(line)).take(10).collect()
}

/// The observed effect of damage to a store.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Seen {
    /// All answers are as before.
    Harmless,
    /// A command or `doctor` reports the damage, and no answer differs.
    Told,
    /// An answer differs, and `doctor` reports the damage.
    DoctorOnly,
}

/// Queries a damaged store, compares it with a healthy one, and saves the intact runs; returns the
/// number of saved runs, and the observed effect.
fn examine(damaged: &Folder, expected: &Answers, rows: &[String], place: &str) -> (usize, Seen) {
    let before = fs::read(damaged.path("jitai.sqlite")).unwrap();
    let answers = ask(damaged, place);
    let differing: Vec<&(String, String)> =
        answers.given.iter().filter(|answer| !expected.given.contains(answer)).collect();
    let differs = !differing.is_empty();
    assert!(
        !(differs && answers.healthy),
        "{place}: silently different: {:#?}",
        new_lines(&differing, &expected.given)
    );
    let salvage = damaged.jitai(["doctor", "--salvage", "new.sqlite", "--format", "json"]);
    assert!(fs::read(damaged.path("jitai.sqlite")).unwrap() == before, "{place}: written to");
    let salvage = salvage.succeeded();
    damaged.jitai(["doctor", "--store", "new.sqlite"]).succeeded().prints("is healthy");
    fs::rename(damaged.path("new.sqlite"), damaged.path("jitai.sqlite")).unwrap();
    for row in damaged.dump().iter().filter(|row| !row.starts_with("run_summary")) {
        assert!(rows.binary_search(row).is_ok(), "{place}: saved what never was: {row:.200}");
    }
    let saved = salvage.json()["completed"].as_u64().unwrap() as usize;
    let seen = match (differs, answers.healthy) {
        (true, _) => Seen::DoctorOnly,
        (false, true) => Seen::Harmless,
        (false, false) => Seen::Told,
    };
    (saved, seen)
}

/// The end of a sweep that was run again on a damaged store.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Rerun {
    /// The sweep was refused or aborted with a message.
    Refused,
    /// The sweep ended, and the store has the same rows as before the damage.
    Same,
    /// The sweep ended, and `doctor` reports the damage.
    DoctorOnly,
}

/// Runs the sweep again on a damaged store, which is not used afterwards.
fn run_again(damaged: &Folder, rows: &[String], place: &str) -> Rerun {
    let run = damaged.jitai(["run", "sweep.toml", "wild.toml", "--quiet"]);
    assert!(!run.stderr.contains("panicked at"), "{place}: {}", run.stderr);
    match run.code {
        // Two jobs of the sweep fail, as before.
        Some(1) => {}
        Some(3) => {
            assert!(run.stderr.contains("error: "), "{place}: {:?}", run.stderr);
            return Rerun::Refused;
        }
        code => panic!("{place}: run ended with {code:?}: {}", run.stderr),
    }
    let doctor = damaged.jitai(["doctor"]);
    match doctor.code {
        Some(0) => {
            assert_same_rows(&damaged.dump(), rows);
            Rerun::Same
        }
        Some(3) => Rerun::DoctorOnly,
        code => panic!("{place}: doctor ended with {code:?}: {}", doctor.stderr),
    }
}

#[test]
fn an_invalid_end_of_a_run_is_reported() {
    let folder = healthy();
    let of_completed = "SELECT ended_at FROM run WHERE status = 'completed'";
    let ended: String = folder.store().query_row(of_completed, [], |row| row.get(0)).unwrap();
    let mut bytes = store(&folder);
    let length = ended.len();
    let at = bytes.windows(length).position(|window| window == ended.as_bytes()).unwrap();
    bytes[at + 4] = b'"';
    let damaged = with_store(&folder, &bytes);
    let told = damaged.jitai(["doctor"]).ended(3);
    told.prints("invalid `started_at` or `ended_at`").prints("13 of 14 completed runs");
    damaged.jitai(["doctor", "--salvage", "new.sqlite"]).succeeded().prints("13 completed runs");
}

#[test]
fn a_changed_value_of_a_parameter_that_jobs_leave_out_is_reported() {
    let folder = healthy();
    let mut bytes = store(&folder);
    let mut entry = b"environment.state_spread".to_vec();
    entry.extend(0.01_f64.to_be_bytes());
    let at = bytes.windows(entry.len()).position(|window| window == entry).unwrap();
    bytes[at + entry.len() - 1] ^= 1;
    let damaged = with_store(&folder, &bytes);
    let doctor = damaged.jitai(["doctor"]).ended(3);
    doctor
        .prints("environment.state_spread mean 0.0")
        .prints("this release declares another value");
    damaged.jitai(["doctor", "--salvage", "new.sqlite"]).succeeded().prints("14 completed runs");
}

#[test]
fn the_failure_of_a_run_is_held_to_what_was_stored() {
    let folder = healthy();
    let bytes = store(&folder);
    let told = b"the loss of update";
    let at = bytes.windows(told.len()).position(|window| window == told).unwrap();
    let mut changed = bytes.clone();
    changed[at + 4] = b'b';
    let damaged = with_store(&folder, &changed);
    damaged.jitai(["doctor"]).ended(3).prints("its failure does not match its digest");
    damaged.jitai(["doctor", "--salvage", "new.sqlite"]).succeeded().prints("14 completed runs");
    damaged.jitai(["doctor", "--store", "new.sqlite"]).succeeded();
    let failed = "SELECT count(*) FROM run_summary WHERE status = 'failed'";
    let left = damaged.jitai(["query", failed, "--store", "new.sqlite", "--format", "csv"]);
    let all = folder.jitai(["query", failed, "--format", "csv"]).succeeded();
    let count = |answer: &Finished| answer.stdout.lines().last().unwrap().parse::<u32>().unwrap();
    assert_eq!(count(&left.succeeded()) + 1, count(&all));
}

#[test]
fn a_changed_byte_anywhere_is_harmless_or_reported_and_the_intact_runs_are_saved() {
    let origin = healthy();
    let (bytes, rows) = (store(&origin), origin.dump());
    let expected = ask(&with_store(&origin, &bytes), "the healthy store");
    let mut chance = ChaCha8Rng::seed_from_u64(SEED);
    let count = env::var("JITAI_DAMAGED_PLACES").map_or(PLACES, |count| count.parse().unwrap());
    let places: Vec<(usize, u8)> = (0..count)
        .map(|_| (chance.next_u64() as usize % bytes.len(), 1 + (chance.next_u32() % 255) as u8))
        .collect();
    let next = AtomicUsize::new(0);
    let counts: [AtomicUsize; 3] = Default::default();
    let reruns: [AtomicUsize; 3] = Default::default();
    let saved_in_all = AtomicUsize::new(0);
    thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| {
                while let Some(&(at, change)) = places.get(next.fetch_add(1, Ordering::Relaxed)) {
                    let mut changed = bytes.clone();
                    changed[at] ^= change;
                    let damaged = with_store(&origin, &changed);
                    let place = format!("byte {at} ^ {change}");
                    let rerun = run_again(&with_store(&origin, &changed), &rows, &place);
                    reruns[rerun as usize].fetch_add(1, Ordering::Relaxed);
                    let (saved, seen) = examine(&damaged, &expected, &rows, &place);
                    counts[seen as usize].fetch_add(1, Ordering::Relaxed);
                    saved_in_all.fetch_add(saved, Ordering::Relaxed);
                }
            });
        }
    });
    let [harmless, told, doctor_only] = counts.map(AtomicUsize::into_inner);
    let saved = saved_in_all.into_inner();
    println!(
        "{count} changed bytes of a store of {} bytes: {harmless} harmless, {told} told, \
         {doctor_only} told by doctor alone; {saved} of {} runs saved",
        bytes.len(),
        14 * count
    );
    let [refused, same, doctor_only] = reruns.map(AtomicUsize::into_inner);
    println!(
        "run again: {refused} refused, {same} ended in the same rows, {doctor_only} ended and told \
         by doctor"
    );
    assert!(saved * 100 >= 14 * count * 85, "{saved}");
}

#[test]
fn a_store_cut_short_is_reported_and_what_is_left_is_saved() {
    let origin = healthy();
    let (bytes, rows) = (store(&origin), origin.dump());
    let expected = ask(&with_store(&origin, &bytes), "the healthy store");
    let diagnosis = origin.jitai(["doctor", "--format", "json"]).succeeded().json();
    let all = diagnosis["completed"].as_u64().unwrap();
    let mut saved_before = 0;
    for step in 1..=40 {
        let length = bytes.len() * step / 41 + 17 * step;
        let damaged = with_store(&origin, &bytes[..length]);
        let place = format!("cut to {length}");
        let answers = ask(&damaged, &place);
        assert!(!answers.healthy, "{place}");
        assert!(answers.given.iter().all(|answer| expected.given.contains(answer)), "{place}");
        let salvage = damaged.jitai(["doctor", "--salvage", "new.sqlite", "--format", "json"]);
        if salvage.code == Some(0) {
            let salvaged = salvage.json();
            let [saved, lost] = ["completed", "lost"].map(|key| salvaged[key].as_u64().unwrap());
            let whole = salvaged["lost_more"] == false;
            assert!(saved + lost == all || (!whole && saved + lost < all), "{place}: {salvaged}");
            assert!(saved >= saved_before, "{place}: a longer piece holds no less");
            saved_before = saved;
            damaged.jitai(["doctor", "--store", "new.sqlite"]).succeeded();
            fs::rename(damaged.path("new.sqlite"), damaged.path("jitai.sqlite")).unwrap();
            for row in damaged.dump().iter().filter(|row| !row.starts_with("run_summary")) {
                assert!(rows.binary_search(row).is_ok(), "{place}: {row:.200}");
            }
        } else {
            salvage.ended(3).says("jitai.sqlite` has no readable store data");
        }
    }
}

#[test]
fn runs_of_rules_which_have_no_weights_are_intact_and_saved() {
    let folder = Folder::new();
    folder.write(
        "rules.toml",
        "format = 1\nname = \"rules\"\nscenarios = [\"P-H-D\"]\nseeds = 2\n\
         [environment]\nsigma = 0.6\n[evaluation]\ntest_episodes = 5\n\
         [[agent]]\nname = \"random\"\nalgorithm = \"rule\"\nrule = \"random\"\n",
    );
    folder.jitai(["run", "rules.toml"]).succeeded();
    folder.jitai(["doctor"]).succeeded().prints("is healthy: 2 completed runs");
    folder.jitai(["doctor", "--salvage", "new.sqlite"]).succeeded();
    let saved = folder.jitai(["doctor", "--store", "new.sqlite"]).succeeded();
    saved.prints("is healthy: 2 completed runs");
}

#[test]
fn a_run_resumes_with_the_salvaged_store_to_the_same_rows() {
    let origin = healthy();
    let (mut bytes, rows) = (store(&origin), origin.dump());
    let weights: i64 = origin.number(
        "SELECT min(pageno) FROM dbstat WHERE name = 'trained_weights' AND pagetype = 'leaf'",
    );
    let page = 4096 * (weights as usize - 1);
    bytes[page..page + 4096].fill(0xa5);
    let damaged = with_store(&origin, &bytes);
    damaged.jitai(["doctor"]).ended(3).prints("jitai.sqlite is damaged:").prints("--salvage");
    let salvage = damaged.jitai(["doctor", "--salvage", "saved.sqlite"]).succeeded();
    let salvage = salvage.prints("2 experiments, 16 jobs");
    assert!(!salvage.stdout.contains("14 completed runs"), "{}", salvage.stdout);
    let run = ["run", "sweep.toml", "wild.toml", "--store", "saved.sqlite", "--quiet"];
    damaged.jitai(run).ended(1);
    fs::rename(damaged.path("saved.sqlite"), damaged.path("jitai.sqlite")).unwrap();
    assert_same_rows(&damaged.dump(), &rows);
    damaged.jitai(["doctor"]).succeeded().prints("14 completed runs");
}

#[test]
fn a_result_that_was_changed_is_found_by_its_digest() {
    let folder = healthy();
    let raw = rusqlite::Connection::open(folder.path("jitai.sqlite")).unwrap();
    raw.execute_batch("PRAGMA writable_schema = ON").unwrap();
    // The change bypasses the triggers and is invisible to SQLite, like a changed byte.
    let rule: String = raw
        .query_row("SELECT sql FROM sqlite_schema WHERE name = 'curve_point_is_fixed'", [], |row| {
            row.get(0)
        })
        .unwrap();
    raw.execute_batch(&format!(
        "DROP TRIGGER curve_point_is_fixed;
         UPDATE curve_point SET value = value + 1 WHERE run = 2 AND episode = 10 AND metric = 1;
         {rule};"
    ))
    .unwrap();
    drop(raw);
    folder.jitai(["query", "SELECT count(*) FROM learning_curve"]).succeeded();
    let diagnosis = folder.jitai(["doctor", "--format", "json"]).ended(3).json();
    assert_eq!((&diagnosis["completed"], &diagnosis["intact"]), (&14.into(), &13.into()));
    let findings = diagnosis["findings"].as_array().unwrap();
    assert_eq!(findings.len(), 1, "{findings:?}");
    assert_eq!(findings[0]["what"], "its results do not match their digest");
    assert_eq!(findings[0]["job_key"].as_str().unwrap().len(), 32);
}

#[test]
fn a_name_of_a_metric_that_was_changed_is_found_by_the_digests() {
    let origin = healthy();
    let with_loss = origin.number(
        "SELECT count(DISTINCT run) FROM curve_point
            WHERE metric = (SELECT id FROM metric_name WHERE name = 'mean_loss')",
    );
    assert!(with_loss > 0);
    let mut bytes = store(&origin);
    // The change affects the table, which readers use, and not its index.
    let page: i64 = origin.number("SELECT min(pageno) FROM dbstat WHERE name = 'metric_name'");
    let page = &mut bytes[4096 * (page as usize - 1)..][..4096];
    let at = page.windows(9).position(|name| name == b"mean_loss").expect("the name's row");
    page[at + 8] = b't';
    let damaged = with_store(&origin, &bytes);
    let name = "SELECT count(*) FROM learning_curve WHERE metric || '' = 'mean_lost'";
    assert!(damaged.number(name) > 0);
    let diagnosis = damaged.jitai(["doctor", "--format", "json"]).ended(3).json();
    assert_eq!(diagnosis["intact"].as_i64(), Some(14 - with_loss));
}

#[test]
fn a_log_left_behind_is_read_and_one_cut_short_loses_its_end_alone() {
    let origin = Folder::with(&manifest("sweep", "0.6", "2", Effort::Trivial));
    origin.jitai(["run", "sweep.toml", "--quiet"]).succeeded();
    let rows = origin.dump();
    // A long-lived reader prevents the log from being cleared.
    let reader = origin.store();
    reader.execute_batch("BEGIN; SELECT * FROM run;").unwrap();
    origin.write("more.toml", manifest("more", "0.4", "2", Effort::Trivial));
    origin.jitai(["run", "more.toml", "--quiet"]).succeeded();
    let main = fs::read(origin.path("jitai.sqlite")).unwrap();
    let log = fs::read(origin.path("jitai.sqlite-wal")).unwrap();
    drop(reader);
    for cut in 0..=20 {
        let folder = Folder::with(&origin.read("sweep.toml"));
        folder.write("jitai.sqlite", &main);
        folder.write("jitai.sqlite-wal", &log[..log.len() * cut / 20]);
        folder.jitai(["doctor"]).succeeded().prints("is healthy");
        folder.jitai(["status"]).succeeded();
        let read = folder.dump();
        assert!(rows.iter().all(|row| read.contains(row)), "cut to {cut} twentieths");
        folder.write("more.toml", origin.read("more.toml"));
        folder.jitai(["run", "sweep.toml", "more.toml", "--quiet"]).succeeded();
        let (run, undisturbed) = (folder.dump(), origin.dump());
        assert_same_rows(&run, &undisturbed);
        folder.jitai(["doctor"]).succeeded();
    }
}

#[test]
fn doctor_refuses_what_is_no_store_and_salvage_what_is_in_the_way() {
    let folder = Folder::new();
    folder.jitai(["doctor"]).ended(3).says("there is no store at");
    folder.write("jitai.sqlite", "");
    folder.jitai(["doctor"]).ended(3).says("is an empty file");
    folder.jitai(["doctor", "--salvage", "new.sqlite"]).ended(3).says("is an empty file");
    folder.write("jitai.sqlite", "text ".repeat(2000));
    folder.jitai(["doctor"]).ended(3).says("is not a SQLite file");
    fs::remove_file(folder.path("jitai.sqlite")).unwrap();
    let foreign = rusqlite::Connection::open(folder.path("jitai.sqlite")).unwrap();
    foreign.execute_batch("CREATE TABLE note (text TEXT); INSERT INTO note VALUES ('x')").unwrap();
    folder.jitai(["doctor"]).ended(3).says("a SQLite file of another program");
    let salvage = folder.jitai(["doctor", "--salvage", "new.sqlite"]).ended(3);
    salvage.says("jitai.sqlite` has no readable store data");
    folder.write("new.sqlite", "precious");
    let salvage = folder.jitai(["doctor", "--salvage", "new.sqlite"]).ended(3);
    salvage.says("`new.sqlite` already exists");
    assert_eq!(folder.read("new.sqlite"), "precious");
    assert!(!Path::new(&folder.path("new.sqlite.salvaging")).exists());
}
