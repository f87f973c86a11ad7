//! Merged stores: shards, conflicts, damage, and kills.

use std::fs;
use std::path::Path;
use std::sync::atomic::AtomicBool;

use jitai::job::Job;
use jitai::job::Outcome;
use jitai::kill_point::VARIABLE;
use jitai::plan::Shard;
use jitai::schedule::{self, Context, Event};
use jitai::store::Store;
use jitai::train::{self, TrainingControl};
use rusqlite::Connection;

use crate::failures::{OPTIONS, queued};
use crate::support::{Effort, Folder, assert_same_rows, manifest, until};

/// A manifest with two agents, one of which fails with every seed.
fn failing() -> String {
    let layers = ["64"; 24].join(", ");
    format!(
        "format = 1\nname = \"failing\"\nscenarios = [\"P-H-D\"]\nseeds = 2\n\
         environment.sigma = 0.6\nevaluation.test_episodes = 20\n\
         [[agent]]\nname = \"wild\"\nalgorithm = \"dueling_dqn\"\nepisodes = 50\n\
         layers = [{layers}]\nbatch = 8\nlearning_rate = 1.0\n\
         [[agent]]\nname = \"never\"\nalgorithm = \"rule\"\nrule = \"never\"\n"
    )
}

/// A folder with two manifests, `sweep.toml` and `failing.toml`.
fn two_manifests() -> Folder {
    let folder = Folder::with(&manifest("sweep", "[0.4, 0.6]", "4", Effort::Trivial));
    folder.write("failing.toml", failing());
    folder
}

/// Runs both manifests, or shards of them, in stores with these names.
fn run_shards(folder: &Folder, shards: &[(&str, &str)]) {
    for (shard, store) in shards {
        let run = ["run", "sweep.toml", "failing.toml", "--shard", shard, "--store", store];
        let ended = folder.jitai(run);
        assert!(matches!(ended.code, Some(0 | 1)), "{}", ended.stderr);
    }
}

/// Every file below a folder, with its path.
fn files(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        match path.is_dir() {
            true => found.extend(files(&path)),
            false => found.push((path.display().to_string(), fs::read(&path).unwrap())),
        }
    }
    found.sort();
    found
}

/// The output of status, plan, report and export for a folder's store, without times and machines.
fn views(folder: &Folder) -> Vec<(String, Vec<u8>)> {
    let mut views = Vec::new();
    let timeless = |text: &str, first_timed: &str| -> String {
        let objects: serde_json::Value = serde_json::from_str(text).unwrap();
        let mut objects = objects.as_array().unwrap().clone();
        objects
            .iter_mut()
            .for_each(|object| drop(object.as_object_mut().unwrap().remove(first_timed)));
        serde_json::Value::from(objects).to_string()
    };
    let status = folder.jitai(["status", "--format", "json"]).succeeded().stdout;
    views.push(("status".to_owned(), timeless(&status, "seconds_left").into_bytes()));
    let failures = folder.jitai(["status"]).succeeded().stdout;
    let (_, failures) = failures.split_once("\n\n").expect("failed jobs are listed");
    let failures = failures.lines().map(|line| line.split(" at 20").next().unwrap_or(line));
    views.push(("failures".to_owned(), failures.collect::<Vec<_>>().join("\n").into_bytes()));
    let plan = ["plan", "sweep.toml", "failing.toml", "--jobs"];
    views.push(("plan".to_owned(), folder.jitai(plan).succeeded().stdout.into_bytes()));
    folder.jitai(["report", "sweep.toml", "failing.toml", "--out", "report"]).succeeded();
    folder.jitai(["export", "--out", "export"]).succeeded();
    for (name, bytes) in
        files(&folder.path("report")).into_iter().chain(files(&folder.path("export")))
    {
        let name = name.rsplit('/').next().unwrap().to_owned();
        let text = String::from_utf8_lossy(&bytes);
        match (name.as_str(), text.split_once("<section id=\"provenance\">")) {
            ("run_summary.csv" | "manifest.csv", _) => {}
            // The last section of a page shows times and machines.
            (_, Some((before, _))) => views.push((name, before.as_bytes().to_vec())),
            (_, None) => views.push((name, bytes)),
        }
    }
    let runs =
        "SELECT experiment, job_key, agent, scenario, sigma, seed, status, attempt, mean_return,
        sd_return, mean_length, disengagement_rate, failure_kind, failure_message FROM run_summary
        ORDER BY 1, 2, 3, 8";
    let runs = folder.jitai(["query", runs, "--format", "csv"]).succeeded().stdout;
    views.push(("run_summary".to_owned(), runs.into_bytes()));
    let manifests = "SELECT experiment, manifest FROM manifest ORDER BY 1, number";
    let manifests = folder.jitai(["query", manifests, "--format", "csv"]).succeeded().stdout;
    views.push(("manifest".to_owned(), manifests.into_bytes()));
    views
}

#[track_caller]
fn assert_same_views(ours: &Folder, theirs: &Folder) {
    let (ours, theirs) = (views(ours), views(theirs));
    let names = |views: &[(String, Vec<u8>)]| -> Vec<String> {
        views.iter().map(|(name, _)| name.clone()).collect()
    };
    assert_eq!(names(&ours), names(&theirs));
    for ((name, ours), (_, theirs)) in ours.iter().zip(&theirs) {
        let (ours, theirs) = (String::from_utf8_lossy(ours), String::from_utf8_lossy(theirs));
        let differing = ours.lines().zip(theirs.lines()).find(|(one, other)| one != other);
        assert!(ours == theirs, "{name}: {differing:?}");
    }
}

#[test]
fn shards_that_are_merged_make_the_store_of_one_machine() {
    let whole = two_manifests();
    whole.jitai(["run", "sweep.toml", "failing.toml"]).ended(1);
    let merged = two_manifests();
    run_shards(&merged, &[("3/3", "c.sqlite"), ("1/3", "a.sqlite"), ("2/3", "b.sqlite")]);
    let ended = merged.jitai(["merge", "a.sqlite", "b.sqlite", "c.sqlite"]).succeeded();
    ended.prints("jitai.sqlite: 18 completed runs and 2 failed runs copied from 3 stores");
    merged.jitai(["doctor"]).succeeded();
    assert_same_views(&merged, &whole);
    let again = merged.jitai(["merge", "c.sqlite", "a.sqlite", "b.sqlite"]).succeeded();
    again.prints(
        "nothing to copy from 3 stores: jitai.sqlite already has 20 runs of them; every completed run has \
         the same results\n",
    );
    let run = merged.jitai(["run", "sweep.toml", "failing.toml"]);
    run.ended(1).says("0 jobs run, 18 completed in all, 2 failed");
}

#[test]
fn a_shard_declares_its_own_jobs_and_keeps_those_of_others() {
    let folder = Folder::with(&manifest("sweep", "0.6", "4", Effort::Trivial));
    let counted =
        |store: &str| folder.jitai(["status", "--format", "json", "--store", store]).json();
    run_shards_of(&folder, &["1/2"], "part.sqlite");
    assert_eq!(counted("part.sqlite")[0]["jobs"], 4);
    run_shards_of(&folder, &["2/2", "1/2"], "part.sqlite");
    assert_eq!(counted("part.sqlite")[0]["completed"], 8);
    // Jobs that the manifest drops leave the experiment, whichever shard runs.
    folder.write("sweep.toml", manifest("sweep", "0.6", "3", Effort::Trivial));
    run_shards_of(&folder, &["1/2"], "part.sqlite");
    assert_eq!(counted("part.sqlite")[0]["jobs"], 6);
    let planned = |shard: &str| {
        let plan = ["plan", "sweep.toml", "--shard", shard, "--format", "json"];
        folder.jitai(plan).succeeded().json()[0]["jobs"].as_u64().unwrap()
    };
    assert_eq!(planned("1/2") + planned("2/2"), 6);
}

fn run_shards_of(folder: &Folder, shards: &[&str], store: &str) {
    for shard in shards {
        folder.jitai(["run", "sweep.toml", "--shard", shard, "--store", store]).succeeded();
    }
}

#[test]
fn shards_beyond_the_jobs_are_empty_and_faulty_ones_are_refused() {
    let folder = Folder::with(&manifest("sweep", "0.6", "1", Effort::Trivial));
    let run = folder.jitai(["run", "sweep.toml", "--shard", "5/5"]).succeeded();
    run.says("nothing to run: none of these jobs is wanted yet");
    folder.jitai(["plan", "sweep.toml", "--shard", "5/5"]).succeeded();
    for (shard, expected) in [
        ("0/4", "shards are counted from 1 to 4, found 0"),
        ("5/4", "shards are counted from 1 to 4, found 5"),
        ("a/b", "such as 3/40"),
        ("1/0", "expected 1 to 1000000 shards, found 0"),
    ] {
        for verb in ["run", "plan"] {
            folder.jitai([verb, "sweep.toml", "--shard", shard]).ended(2).says(expected);
        }
    }
}

#[test]
fn shards_have_about_the_same_work() {
    let text = manifest("sweep", "[0.4, 0.6]", "100", Effort::Short);
    let manifest = jitai::manifest::parse("sweep", text.as_bytes()).unwrap();
    let works =
        || jitai::plan::jobs(&manifest).map(|planned| (planned.job.key(), planned.job.work()));
    let all: u64 = works().map(|(_, work)| work).sum();
    for number in 1..=13 {
        let keys = format!("{number}/13").parse::<Shard>().unwrap().keys(works());
        let work: u64 = works().filter(|(key, _)| keys.contains(key)).map(|(_, work)| work).sum();
        let share = work as f64 * 13.0 / all as f64;
        assert!((0.95..1.05).contains(&share), "{number}: {share}");
    }
}

#[test]
fn a_folder_stands_for_its_stores() {
    let folder = Folder::with(&manifest("sweep", "0.6", "2", Effort::Trivial));
    fs::create_dir_all(folder.path("submission/parts")).unwrap();
    run_shards_of(&folder, &["1/2"], "submission/parts/1.sqlite");
    run_shards_of(&folder, &["2/2"], "submission/parts/2.sqlite");
    let sealed = folder.path("submission/parts/1.sqlite");
    let mut permissions = fs::metadata(&sealed).unwrap().permissions();
    permissions.set_readonly(true);
    fs::set_permissions(&sealed, permissions).unwrap();
    let merged = folder.jitai(["merge", "submission", "--format", "json"]).succeeded().json();
    assert_eq!((&merged["stores"], &merged["completed"]), (&2.into(), &4.into()), "{merged}");
    assert!(!folder.path("submission/parts/1.sqlite-wal").exists());
    assert!(!folder.path("submission/parts/1.sqlite-shm").exists());
    // The folder also contains the target store.
    folder.jitai(["merge", "."]).ended(2).says("no file in `.` ends in .sqlite");
    folder.jitai(["merge", "jitai.sqlite"]).ended(3).says("is the target store (--store)");
}

#[test]
fn what_is_no_store_ends_a_merge_before_it_begins() {
    let folder = Folder::with(&manifest("sweep", "0.6", "1", Effort::Trivial));
    run_shards_of(&folder, &["1/1"], "good.sqlite");
    run_shards_of(&folder, &["1/1"], "newer.sqlite");
    let newer = Connection::open(folder.path("newer.sqlite")).unwrap();
    newer.execute_batch("PRAGMA user_version = 999").unwrap();
    drop(newer);
    let foreign = Connection::open(folder.path("foreign.sqlite")).unwrap();
    foreign.execute_batch("CREATE TABLE t (x)").unwrap();
    folder.write("text.sqlite", "no store\n".repeat(100));
    folder.write("empty.sqlite", "");
    for (name, expected) in [
        ("newer.sqlite", "has schema version 999"),
        ("foreign.sqlite", "a SQLite file of another program; nothing was merged"),
        ("text.sqlite", "it is not a SQLite file"),
        ("empty.sqlite", "it is an empty file; nothing was merged"),
        ("absent.sqlite", "it does not exist; nothing was merged"),
    ] {
        folder.jitai(["merge", "good.sqlite", name]).ended(3).says(expected);
        assert!(!folder.path("jitai.sqlite").exists(), "{name}");
    }
}

#[test]
fn a_store_of_the_first_release_is_merged_and_left_as_it_is() {
    let folder = Folder::new();
    let stored = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/stores/v1-0.1.0.sqlite");
    let before = fs::read(stored).unwrap();
    folder.write("old.sqlite", &before);
    let merged = folder.jitai(["merge", "old.sqlite"]).succeeded();
    merged.prints(
        "7 completed runs and 1 failed run copied from 1 store, with 8 jobs and 2 experiments",
    );
    assert!(fs::read(folder.path("old.sqlite")).unwrap() == before);
    folder.jitai(["doctor"]).succeeded().prints("is healthy: 7 completed runs");
}

#[test]
fn a_job_with_other_results_is_a_conflict_and_the_store_keeps_its_own() {
    let folder = Folder::completed(&manifest("sweep", "0.6", "2", Effort::Trivial));
    fs::rename(folder.path("jitai.sqlite"), folder.path("theirs.sqlite")).unwrap();
    // A faulty machine: it adds 1 to a metric of a job.
    let train = |job: &Job, control: &dyn TrainingControl| match train::run(job, control) {
        Outcome::Completed(mut results) if job.seed == 2 && job.algorithm() == "reinforce" => {
            results.metrics[0].value += 1.0;
            Outcome::Completed(results)
        }
        outcome => outcome,
    };
    let (mut store, session, queue) = queued(&folder, &folder.read("sweep.toml"));
    let key = queue[3].key.to_string();
    let context =
        Context { options: OPTIONS, train: &train, stop: &AtomicBool::new(false), curves: None };
    schedule::run(&mut store, session, queue, context, &mut |_: Event<'_>| {}).unwrap();
    store.end_session(session).unwrap();
    drop(store);

    let before = folder.dump();
    let merged = folder.jitai(["merge", "theirs.sqlite"]).ended(1);
    let said =
        format!("job {key} has different results in theirs.sqlite; jitai.sqlite keeps its own");
    let merged = merged.prints(&said).prints("by jitai 0.1.0 (unknown) on here (any)");
    let merged =
        merged.prints("nothing to copy from 1 store: jitai.sqlite already has 3 runs of them\n");
    let digests: Vec<&str> =
        merged.stdout.lines().filter_map(|line| line.strip_prefix("  ")).collect();
    let digest = |store: &str, line: &str| {
        assert!(line.contains(&format!(" in {store}, by jitai")), "{line}");
        line.split(' ').next().unwrap().to_owned()
    };
    let (theirs, ours) = (digest("theirs.sqlite", digests[0]), digest("jitai.sqlite", digests[1]));
    assert!(theirs.len() == 64 && ours.len() == 64 && theirs != ours, "{digests:?}");
    let json = folder.jitai(["merge", "theirs.sqlite", "--format", "json"]).ended(1).json();
    assert_eq!(json["conflicts"][0]["job_key"], *key);
    assert_eq!(json["conflicts"][0]["ours"]["host"], "here");
    assert_eq!(json["conflicts"][0]["theirs"]["results_sha256"], *theirs);
    assert_same_rows(&folder.dump(), &before);

    // The view has the conflict once, and a merge passes it on. A store that has the other results has
    // none of its own.
    let conflicts = |store: &str| {
        let sql =
            "SELECT job_key, source, results_sha256, host, processor, code_version, kept_sha256
            FROM conflict";
        folder.jitai(["query", sql, "--format", "csv", "--store", store]).succeeded().stdout
    };
    let host = fs::read_to_string("/proc/sys/kernel/hostname").unwrap();
    let found = conflicts("jitai.sqlite");
    assert_eq!(found.lines().count(), 2, "{found}");
    let start = format!("{key},theirs.sqlite,{theirs},{},", host.trim());
    assert!(found.lines().nth(1).unwrap().starts_with(&start), "{found}");
    assert!(found.trim_end().ends_with(&format!(",0.1.0,{ours}")), "{found}");
    folder.jitai(["merge", "jitai.sqlite", "--store", "copy.sqlite"]).succeeded();
    assert_eq!(conflicts("copy.sqlite"), found);
    folder.jitai(["merge", "copy.sqlite", "--store", "theirs.sqlite"]).ended(1);
    let turned = conflicts("theirs.sqlite");
    let start = format!("{key},copy.sqlite,{ours},here,any,");
    assert!(turned.lines().nth(1).unwrap().starts_with(&start), "{turned}");
    assert_eq!(turned.lines().count(), 2, "{turned}");
    folder.jitai(["export", "--out", "export"]).succeeded();
    assert_eq!(folder.read("export/conflict.csv").lines().count(), 2);
    let machines = "SELECT DISTINCT host, processor, backend, git_revision FROM run_summary";
    let machines = folder.jitai(["query", machines, "--format", "csv"]).succeeded();
    machines.prints("here,any,");
    folder.jitai(["doctor", "--salvage", "saved.sqlite"]).succeeded();
    assert_eq!(conflicts("saved.sqlite"), found);
    folder.jitai(["forget", "sweep", "--results", "--yes"]).succeeded();
    assert_eq!(conflicts("jitai.sqlite").lines().count(), 1);
    folder.jitai(["doctor"]).succeeded().prints("is healthy");
}

#[test]
fn a_damaged_run_is_named_and_left_out() {
    let folder = Folder::with(&manifest("sweep", "0.6", "2", Effort::Trivial));
    run_shards_of(&folder, &["1/1"], "a.sqlite");
    let raw = Connection::open(folder.path("a.sqlite")).unwrap();
    let rule: String = raw
        .query_row("SELECT sql FROM sqlite_schema WHERE name = 'run_metric_is_fixed'", [], |row| {
            row.get(0)
        })
        .unwrap();
    raw.execute_batch(&format!(
        "DROP TRIGGER run_metric_is_fixed;
         UPDATE run_metric SET value = value + 1 WHERE run = 2 AND metric = 1; {rule}"
    ))
    .unwrap();
    let key: String = raw
        .query_row("SELECT key FROM job JOIN run ON run.job = job.id WHERE run.id = 2", [], |row| {
            row.get(0)
        })
        .unwrap();
    let merged = folder.jitai(["merge", "a.sqlite"]).ended(1);
    let said = format!(
        "a.sqlite is damaged; not merged: the run of job {key}: its results do not \
         match their digest"
    );
    merged.prints(&said).prints("3 completed runs and 0 failed runs copied");
    assert_eq!(folder.runs(), 3);
    folder.jitai(["run", "sweep.toml"]).succeeded().says("1 job run, 4 completed in all");
    // The store now has the run, so the damaged copy is not read.
    folder.jitai(["merge", "a.sqlite"]).succeeded().prints("already has 4 runs of them");
}

#[test]
fn a_source_without_runs_is_nothing_to_copy() {
    let folder = Folder::completed(&manifest("sweep", "0.6", "1", Effort::Trivial));
    drop(Store::open(&folder.path("empty.sqlite")).unwrap());
    let merged = folder.jitai(["merge", "empty.sqlite"]).succeeded();
    assert_eq!(merged.stdout, "nothing to copy from 1 store\n");
}

#[test]
fn a_source_that_is_written_to_is_read_as_it_was_at_one_moment() {
    let folder = Folder::with(&manifest("sweep", "[0.4, 0.6]", "10", Effort::Short));
    let source = folder.start(["run", "sweep.toml", "--store", "source.sqlite", "--workers", "2"]);
    let completed = |store: &str| -> i64 {
        let count = || {
            let store = Connection::open(folder.path(store)).ok()?;
            let sql = "SELECT count(*) FROM run WHERE status = 'completed'";
            store.query_row(sql, [], |row| row.get(0)).ok()
        };
        count().unwrap_or(0)
    };
    let mut before = 0;
    for _ in 0..3 {
        until("some more are completed", || completed("source.sqlite") > before + 2);
        folder.jitai(["merge", "source.sqlite"]).succeeded();
        before = completed("jitai.sqlite");
    }
    assert!((9..=40).contains(&before), "{before}");
    source.wait().succeeded();
    folder.jitai(["merge", "source.sqlite"]).succeeded().prints("were already there");
    let whole = Folder::completed(&manifest("sweep", "[0.4, 0.6]", "10", Effort::Short));
    assert_same_rows(&folder.dump(), &whole.dump());
}

#[test]
fn a_merge_beside_a_sweep_and_readers_disturbs_neither() {
    let text = manifest("sweep", "[0.4, 0.6]", "6", Effort::Short);
    let folder = Folder::with(&text);
    run_shards_of(&folder, &["1/2"], "half.sqlite");
    let sweep = folder.start(["run", "sweep.toml", "--workers", "2"]);
    until("a job runs", || folder.is_running_a_job());
    let merge = folder.start(["merge", "half.sqlite"]);
    for _ in 0..5 {
        folder.jitai(["status"]).succeeded();
        folder.jitai(["query", "SELECT count(*) FROM run_summary"]).succeeded();
    }
    let merged = merge.wait().succeeded();
    sweep.wait().succeeded().says("24 completed in all, 0 failed");
    assert!(merged.stdout.contains("copied from 1 store"), "{}", merged.stdout);
    // Jobs that were running then are now completed, with the same results.
    folder.jitai(["merge", "half.sqlite"]).succeeded().prints("already has 12 runs of them");
    assert_eq!(folder.number("SELECT count(*) FROM run WHERE status = 'completed'"), 24);
    assert_same_rows(&folder.dump(), &Folder::completed(&text).dump());
    folder.jitai(["doctor"]).succeeded();
}

#[test]
fn a_merge_that_is_killed_and_repeated_leaves_what_an_undisturbed_one_does() {
    let undisturbed = two_manifests();
    run_shards(&undisturbed, &[("1/2", "a.sqlite"), ("2/2", "b.sqlite")]);
    undisturbed.jitai(["merge", "a.sqlite", "b.sqlite"]).succeeded();
    for point in ["before-commit", "after-commit"] {
        let killed = two_manifests();
        for store in ["a.sqlite", "b.sqlite"] {
            fs::copy(undisturbed.path(store), killed.path(store)).unwrap();
        }
        let mut kills = 0;
        for passes in 1.. {
            let mut merge = killed.command(["merge", "a.sqlite", "b.sqlite"]);
            let merge = merge.env(VARIABLE, format!("{point}:{passes}")).output().unwrap();
            if merge.status.code() == Some(0) {
                break;
            }
            assert_eq!(merge.status.code(), None, "{}", String::from_utf8_lossy(&merge.stderr));
            kills += 1;
        }
        assert!(kills > 8, "{point}: {kills}");
        assert_same_rows(&killed.everything(), &undisturbed.everything());
    }
}

/// One manifest for every shape of a job: tests and trials, every family, decisions recorded and not, posteriors,
/// estimates.
fn shapes() -> Vec<String> {
    let head = |name: &str| format!("format = 1\nname = \"{name}\"\nseeds = 1\n");
    let random = "[[agent]]\nname = \"random\"\nalgorithm = \"rule\"\nrule = \"random\"\n";
    let thompson = "[[agent]]\nname = \"thompson\"\nalgorithm = \"linear_thompson\"\n";
    let estimate = "[[estimate]]\nname = \"effect\"\n";
    let step_count = "scenarios = [\"P-H-D\"]\nenvironment.sigma = 0.4\nenvironment.horizon = 10\npopulation.delta_d = 0.2\n";
    let trial = "trial = { people = 8, days = 10, pooling = [\"full\", \"partial\"] }\n";
    let oralytics = "scenarios = [[\"time_of_day\", \"brushing\", \"dosage\", \"app\"]]\n";
    let outside = "scenarios = [\"all\"]\n";
    let of_oralytics = "[environment]\nfamily = \"declared\"\nmodel = \"oralytics_v2\"\npeople = \"people.csv\"\ndays = 5\n";
    let of_outside = "[environment]\nfamily = \"external\"\ncommand = [\"python3\", \"own.py\"]\n\
        version = \"1\"\n";
    let mut all = Vec::new();
    let twice = "trial = { people = 8, days = 5, decisions_per_day = 2 }\n";
    for (family, scenarios, environment, trial) in [
        ("step", step_count, "", trial),
        ("oral", oralytics, of_oralytics, twice),
        ("own", outside, of_outside, trial),
    ] {
        for record in ["none", "test", "all"] {
            let name = head(&format!("{family}-test-{record}"));
            let evaluation =
                format!("[evaluation]\ntest_episodes = 4\nrecord_decisions = \"{record}\"\n");
            let learner = "episodes = 5\n";
            all.push(format!(
                "{name}{scenarios}{environment}{evaluation}{random}{thompson}{learner}"
            ));
        }
        for record in ["none", "test"] {
            let name = head(&format!("{family}-trial-{record}"));
            let posteriors = "record_posteriors = true\n";
            let evaluation = format!(
                "[evaluation]\non = \"trial\"\nrecord_decisions = \"{record}\"\n{posteriors}"
            );
            let estimate = if record == "test" { estimate } else { "" };
            all.push(format!(
                "{name}{scenarios}{trial}{environment}{evaluation}{random}{thompson}{estimate}"
            ));
        }
    }
    all
}

/// An outside environment with a state of its own.
const OWN: &str = r#"
import json, sys
steps = {}
for line in sys.stdin:
    m = json.loads(line)
    if m["type"] == "describe":
        said = {"type": "description", "protocol": 1, "features": [{"name": "x"}], "actions": ["a", "b"], "horizon": 10}
    elif m["type"] == "reset":
        steps.update({lane: 0 for lane in m["lanes"]})
        said = {"type": "began", "observations": [[0.0] for _ in m["lanes"]]}
    elif m["type"] == "step":
        for lane in m["lanes"]:
            steps[lane] += 1
        said = {"type": "stepped", "observations": [[steps[lane] / 10] for lane in m["lanes"]],
                "rewards": [1.0 * a + (lane % 3) for lane, a in zip(m["lanes"], m["actions"])],
                "truncated": [steps[lane] >= 10 for lane in m["lanes"]]}
    else:
        continue
    print(json.dumps(said), flush=True)
"#;

#[test]
fn a_job_of_every_shape_is_merged_and_salvaged_with_all_of_its_rows() {
    let folder = Folder::new();
    folder.write("own.py", OWN);
    folder.write("people.csv", include_str!("../../experiments/oralytics/synthetic_v2.csv"));
    let shapes = shapes();
    let mut arguments = vec!["run".to_owned()];
    for (number, shape) in shapes.iter().enumerate() {
        folder.write(&format!("{number}.toml"), shape);
        arguments.push(format!("{number}.toml"));
    }
    arguments.push("--quiet".to_owned());
    folder.jitai(arguments.iter().map(String::as_str)).succeeded();
    folder.jitai(["doctor"]).succeeded().prints("is healthy");
    folder.jitai(["merge", "jitai.sqlite", "--store", "merged.sqlite"]).succeeded();
    folder.jitai(["doctor", "--salvage", "salvaged.sqlite"]).succeeded();
    let tables = |store: &str| -> Vec<String> {
        let store = Connection::open(folder.path(store)).unwrap();
        let names = "SELECT name FROM sqlite_schema WHERE type = 'table'
            AND (name GLOB 'recorded_*' OR name IN ('run_metric', 'curve_point', 'test_episode', 'action_count',
                'action_total', 'trained_weights')) AND name <> 'recorded_command' ORDER BY name";
        let count = |table: String| {
            let sql = format!("SELECT '{table}: ' || count(*) FROM {table}");
            store.query_row(&sql, [], |row| row.get::<_, String>(0)).unwrap()
        };
        let mut statement = store.prepare(names).unwrap();
        let names = statement.query_map([], |row| row.get(0)).unwrap();
        names.map(|name| count(name.unwrap())).collect()
    };
    let ours = tables("jitai.sqlite");
    let empty: Vec<&String> = ours.iter().filter(|count| count.ends_with(": 0")).collect();
    assert_eq!(empty, ["recorded_conflict: 0"; 1], "{ours:?}");
    for store in ["merged.sqlite", "salvaged.sqlite"] {
        assert_eq!(tables(store), ours, "{store}");
        folder.jitai(["doctor", "--store", store]).succeeded().prints("is healthy");
        let unchanged = folder.jitai(["merge", store]).succeeded();
        unchanged.prints("nothing to copy from 1 store");
    }
}
