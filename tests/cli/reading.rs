//! `status`, `query` and `export`: the content of a store for people and programs.

use std::fs;
use std::io::Write;
use std::process::Stdio;

use rusqlite::Connection;
use serde_json::json;

use crate::support::{Effort, Folder, columns, manifest, until, views};

fn completed() -> Folder {
    Folder::completed(&manifest("sweep", "[0.4, 0.6]", "2", Effort::Trivial))
}

#[test]
fn status_shows_every_experiment_to_people_and_programs() {
    let folder = completed();
    folder.write("other.toml", manifest("other", "0.6", "3", Effort::Trivial));
    folder.jitai(["run", "other.toml", "--filter", "seed=1"]).succeeded();
    let status = folder.jitai(["status", "--format", "json"]).succeeded().json();
    let counts = |row: usize| {
        ["experiment", "jobs", "completed", "pending"].map(|name| status[row][name].clone())
    };
    assert_eq!(counts(0), [json!("sweep"), json!(8), json!(8), json!(0)]);
    // The experiments share seed 2.
    assert_eq!(counts(1), [json!("other"), json!(6), json!(4), json!(2)]);
    let table = folder.jitai(["status"]).succeeded().stdout;
    let words: Vec<_> = table.lines().nth(1).unwrap().split_whitespace().collect();
    assert_eq!(words[..7], ["sweep", "8", "8", "0", "0", "0", "0"]);
    // All jobs have ended, so there is nothing to watch.
    folder.jitai(["run", "other.toml"]).succeeded();
    folder.jitai(["watch", "--plain"]).succeeded().prints("other");
}

#[test]
fn a_watch_ends_when_no_process_runs_what_is_left() {
    let folder = Folder::with(&manifest("sweep", "0.6", "2", Effort::Trivial));
    folder.jitai(["run", "sweep.toml", "--filter", "seed=1"]).succeeded();
    let watch = folder.jitai(["watch", "--plain"]).succeeded();
    watch.says("2 jobs left, but no process is running; resume with `jitai run`");
}

#[test]
fn status_and_plan_agree_on_the_time_left() {
    let folder = Folder::with(&manifest("sweep", "0.6", "400", Effort::Short));
    folder.jitai(["run", "sweep.toml", "--filter", "seed=1"]).succeeded();
    let left = |arguments: &[&str]| {
        let arguments = arguments.iter().copied().chain(["--format", "json"]);
        folder.jitai(arguments).succeeded().json()[0]["seconds_left"].as_f64().unwrap()
    };
    let seconds = left(&["status"]);
    assert_eq!(seconds, left(&["plan", "sweep.toml"]));
    assert!(seconds > 0.0 && (seconds * 10.0).fract() == 0.0, "{seconds}");
}

#[test]
fn status_estimates_the_time_for_the_workers_that_run() {
    // Four jobs.
    let folder = Folder::with(&manifest("sweep", "0.6", "2", Effort::Endless));
    let left = |arguments: &[&str]| {
        let arguments = arguments.iter().copied().chain(["--format", "json"]);
        folder.jitai(arguments).succeeded().json()[0]["seconds_left"].as_f64().unwrap()
    };
    for workers in ["1", "3"] {
        let run = folder.start(["run", "sweep.toml", "--workers", workers]);
        let running = "SELECT count(*) FROM run WHERE status = 'running'";
        until("all workers run", || folder.count_if_there(running) == workers.parse().ok());
        assert_eq!(left(&["status"]), left(&["plan", "sweep.toml", "--workers", workers]));
        run.signal("INT");
        run.wait().ended(130);
    }
    // More workers than jobs are of no use.
    let of_plan = |workers: &str| left(&["plan", "sweep.toml", "--workers", workers]);
    assert_eq!(of_plan("4"), of_plan("100"));
    assert!(of_plan("3") < of_plan("1"));
}

#[test]
fn a_query_answers_in_three_formats() {
    let folder = completed();
    let sql = "SELECT agent, sigma, count(*) AS runs, NULL AS gap, 'a,\"b\"' AS words
               FROM run_summary GROUP BY 1, 2 ORDER BY 1, 2 LIMIT 1";
    let csv = folder.jitai(["query", sql, "--format", "csv"]).succeeded().stdout;
    assert_eq!(csv, "agent,sigma,runs,gap,words\ndqn,0.4,2,,\"a,\"\"b\"\"\"\n");
    let json = folder.jitai(["query", sql, "--format", "json"]).succeeded().json();
    let row = json!(
        { "agent": "dqn", "sigma": 0.4, "runs": 2, "gap": null, "words": "a,\"b\"" });
    assert_eq!(json, json!([row]));
    let table = folder.jitai(["query", sql]).succeeded().stdout;
    let lines: Vec<Vec<&str>> =
        table.lines().map(|line| line.split_whitespace().collect()).collect();
    assert_eq!(lines[0], ["agent", "sigma", "runs", "gap", "words"]);
    assert_eq!(lines[1], ["dqn", "0.4", "2", "a,\"b\""]);
}

#[test]
fn an_answer_without_rows_has_its_columns() {
    let folder = completed();
    let sql = "SELECT agent, seed FROM run_summary WHERE false";
    assert_eq!(folder.jitai(["query", sql, "--format", "csv"]).succeeded().stdout, "agent,seed\n");
    assert_eq!(folder.jitai(["query", sql, "--format", "json"]).succeeded().json(), json!([]));
    assert_eq!(folder.jitai(["query", sql]).succeeded().stdout, "agent  seed\n");
}

#[test]
fn values_that_are_too_long_to_read_are_cut_in_tables_alone() {
    let folder = Folder::completed(&manifest("sweep", "0.6", "1", Effort::Trivial));
    let sql = "SELECT zeroblob(200000) AS bytes, printf('%.*c', 200000, 'ä') AS text";
    let ask = |format| folder.jitai(["query", sql, "--format", format]).succeeded();
    let table = ask("table").stdout;
    assert!(table.chars().count() < 10_000, "{}", table.len());
    assert!(table.contains("00… (200000 bytes)") && table.contains("ä… (200000 characters)"));
    let json = ask("json").json();
    assert_eq!(json[0]["bytes"].as_str().unwrap(), format!("x'{}'", "00".repeat(200_000)));
    assert_eq!(json[0]["text"].as_str().unwrap(), "ä".repeat(200_000));
    assert_eq!(
        ask("csv").stdout.lines().nth(1).unwrap().chars().count(),
        400_000 + 3 + 1 + 200_000
    );
}

#[test]
fn a_query_can_come_from_standard_input() {
    let folder = completed();
    let mut child = folder
        .command(["query", "-", "--format", "csv"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let sql = b"-- how many\nSELECT count(*) AS n FROM run_summary;\n";
    child.stdin.take().unwrap().write_all(sql).unwrap();
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.stdout, b"n\n8\n");
}

#[test]
fn faulty_sql_is_refused_with_its_place() {
    let folder = completed();
    let fault = folder.jitai(["query", "SELECT agent,\n  mood FROM run_summary"]).ended(2);
    let fault = fault.says("no such column: mood at line 2, column 3");
    let fault = fault
        .says("\n    mood FROM run_summary\n    ^\nthe view run_summary has experiment, job_key,");
    assert_eq!(fault.stdout, "");
    folder.jitai(["query", "SELEC 1"]).ended(2).says("at line 1, column 1");
    folder.jitai(["query", ""]).ended(2).says("the query is empty");
    folder
        .jitai(["query", "SELECT 1; SELECT 2"])
        .ended(2)
        .says("expected one statement, found several");
}

#[test]
fn a_query_writes_nothing() {
    let folder = completed();
    let before = fs::read(folder.path("jitai.sqlite")).unwrap();
    for sql in [
        "INSERT INTO experiment (name) VALUES ('x')",
        "DELETE FROM run",
        "DROP VIEW run_summary",
        "ATTACH 'other.sqlite' AS other",
        "VACUUM INTO 'other.sqlite'",
        "PRAGMA journal_mode = DELETE",
        "PRAGMA writable_schema = ON",
        "SELECT load_extension('x')",
        "BEGIN IMMEDIATE",
    ] {
        folder.jitai(["query", sql]).ended(2).says("a query may only read this store");
    }
    assert_eq!(fs::read(folder.path("jitai.sqlite")).unwrap(), before);
    assert!(!folder.path("other.sqlite").exists());
}

#[test]
fn export_writes_every_view_with_its_columns_and_rows() {
    let folder = completed();
    let recorded = manifest("recorded", "0.6", "1", Effort::Trivial);
    let recorded = recorded.replace(
        "[[agent]]\nname = \"dqn\"",
        "evaluation.record_decisions = \"all\"\npopulation.delta_d = { uniform = [0.05, 0.15] }\n\
         [[agent]]\nname = \"dqn\"",
    );
    let estimate = "[[estimate]]\nname = \"effect\"\nagents = \"reinforce\"\n";
    folder.write("recorded.toml", recorded + estimate);
    folder.write("learned.toml", crate::docs::LEARNED);
    folder.jitai(["run", "recorded.toml", "learned.toml", "--quiet"]).succeeded();
    // The results of another machine, which a merge found.
    let conflict = "INSERT INTO recorded_conflict
            (job, results_sha256, found_at, source, host, processor, code_version, git_revision)
        SELECT job, zeroblob(32), ended_at, 'theirs.sqlite', 'there', 'any', '0', '0'
        FROM run WHERE status = 'completed' LIMIT 1";
    Connection::open(folder.path("jitai.sqlite")).unwrap().execute_batch(conflict).unwrap();
    folder.jitai(["export", "--out", "results/csv"]).succeeded().says("run_summary.csv");
    folder.jitai(["export", "--out", "results/json", "--format", "json"]).succeeded();
    let store = folder.store();
    let views = views(&store);
    assert_eq!(views.len(), 15);
    for view in &views {
        let columns = columns(&store, view);
        let count = folder.number(&format!("SELECT count(*) FROM {view}"));
        let path = folder.path(&format!("results/csv/{view}.csv"));
        let mut csv = csv::Reader::from_path(path).unwrap();
        assert_eq!(csv.headers().unwrap(), columns, "{view}");
        assert_eq!(csv.records().map(Result::unwrap).count() as i64, count, "{view}");

        let json = folder.read(&format!("results/json/{view}.json"));
        let json: serde_json::Value = serde_json::from_str(&json).unwrap();
        let rows = json.as_array().unwrap();
        assert_eq!(rows.len() as i64, count, "{view}");
        assert!(columns.iter().all(|column| rows[0].get(column).is_some()), "{view}");
    }
    for folder_name in ["csv", "json"] {
        let files = fs::read_dir(folder.path("results").join(folder_name)).unwrap().count();
        assert_eq!(files, views.len() + 2, "columns.csv, manifests, and nothing else");
    }
}

#[test]
fn an_export_of_one_experiment_has_its_rows_alone_and_says_what_they_are() {
    let folder = completed();
    folder.write("other.toml", manifest("other", "0.2", "1", Effort::Trivial));
    folder.jitai(["run", "other.toml", "--quiet"]).succeeded();
    folder.jitai(["export", "--out", "all"]).succeeded();
    folder.jitai(["export", "--out", "one", "--experiment", "other"]).succeeded();
    let views = views(&folder.store());
    let rows = |out: &str, view: &str| -> Vec<csv::StringRecord> {
        let mut table = csv::Reader::from_path(folder.path(&format!("{out}/{view}.csv"))).unwrap();
        table.records().map(Result::unwrap).collect()
    };
    let keys = folder.jitai([
        "query",
        "--format",
        "csv",
        "SELECT job_key FROM run_summary WHERE experiment = 'other'",
    ]);
    let keys = keys.succeeded().stdout;
    let keys: Vec<&str> = keys.lines().skip(1).collect();
    assert_eq!(keys.len(), 2);
    for view in &views {
        let is_of_it = |field: &str| field == "other" || keys.contains(&field);
        let mut expected = rows("all", view);
        expected.retain(|row| row.iter().any(is_of_it));
        assert_eq!(rows("one", view), expected, "{view}");
        let header = folder.read(&format!("one/{view}.csv"));
        let mut dictionary = csv::Reader::from_path(folder.path("one/columns.csv")).unwrap();
        let described: Vec<String> = dictionary
            .records()
            .map(Result::unwrap)
            .filter(|record| &record[0] == view)
            .map(|record| record[1].to_owned())
            .collect();
        assert_eq!(header.lines().next().unwrap(), described.join(","), "{view}");
    }
    assert_eq!(folder.read("one/manifests/other.toml"), folder.read("other.toml"));
    assert!(!folder.path("one/manifests/sweep.toml").exists());
    let unknown = folder.jitai(["export", "--out", "none", "--experiment", "othre"]).ended(2);
    unknown.says("the store has no experiment `othre`, did you mean `other`?; it has sweep, other");
    assert!(!folder.path("none").exists());
}

#[test]
fn an_export_removes_the_manifests_of_an_earlier_one_unless_they_were_changed() {
    let folder = Folder::completed(&manifest("sweep", "0.6", "1", Effort::Trivial));
    for name in ["other", "third"] {
        folder.write("other.toml", manifest(name, "0.6", "1", Effort::Trivial));
        folder.jitai(["run", "other.toml", "--quiet"]).succeeded();
    }
    folder.jitai(["export", "--out", "out"]).succeeded();
    folder.write("out/manifests/mine.toml", "written by somebody");
    folder.write("out/manifests/third.toml", "changed by somebody");
    folder.write("other.toml", "not of the export");
    for name in ["other", "third"] {
        folder.jitai(["forget", name, "--yes"]).succeeded();
    }
    let export = folder.jitai(["export", "--out", "out"]).succeeded();
    export
        .says("out/manifests/other.toml removed")
        .says("third.toml of an earlier export was changed");
    let mut left: Vec<_> = fs::read_dir(folder.path("out/manifests"))
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    left.sort();
    assert_eq!(left, [".index.csv", "mine.toml", "sweep.toml", "third.toml"]);
    assert_eq!(folder.read("other.toml"), "not of the export");
    // A list that was tampered with names no file outside of its folder.
    let index = folder.read("out/manifests/.index.csv");
    let digest = "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855";
    folder.write("out/manifests/.index.csv", format!("{index}../../empty,x,{digest}\n"));
    folder.write("empty", "");
    folder.jitai(["export", "--out", "out"]).succeeded();
    assert!(folder.path("empty").exists());
}

#[test]
fn an_export_names_the_files_that_its_manifests_read() {
    let text = manifest("sweep", "0.6", "1", Effort::Trivial);
    let folder = Folder::with(&text.replacen(
        "[[agent]]",
        "[population]\nrows = \"people.csv\"\n[[agent]]",
        1,
    ));
    folder.write("people.csv", "delta_d,delta_h\n0.1,0.1\n0.2,0.05\n");
    folder.jitai(["run", "sweep.toml", "--quiet"]).succeeded();
    let export = folder.jitai(["export", "--out", "results"]).succeeded();
    export.says("note: manifests/sweep.toml reads people.csv, which the store does not have");
}

#[test]
fn an_export_again_is_the_same_to_the_byte() {
    let folder = completed();
    let export = |out: &str| {
        folder.jitai(["export", "--out", out]).succeeded();
        let store = folder.store();
        let read = |view: &String| folder.read(&format!("{out}/{view}.csv"));
        views(&store).iter().map(read).collect::<Vec<_>>()
    };
    assert_eq!(export("one"), export("two"));
}

#[test]
fn the_actor_of_ppo_is_exported_and_so_is_a_memory() {
    let folder = Folder::completed(
        "format = 1\nname = \"two\"\nscenarios = [\"P-H-D\"]\nseeds = 1\n\
         environment.sigma = 0.6\nenvironment.horizon = 5\nevaluation.test_episodes = 20\n\
         [[agent]]\nname = \"plain\"\nalgorithm = \"ppo\"\nepisodes = 20\nlayers = [6, 5]\n\
         [[agent]]\nname = \"ppo-gru\"\nalgorithm = \"ppo\"\nepisodes = 20\nrecurrent = \"gru\"\n\
         [[agent]]\nname = \"dqn-gru\"\nalgorithm = \"dueling_dqn\"\nepisodes = 20\n\
         recurrent = \"gru\"\nbatch = 4\nlayers = [6]\n",
    );
    let key = |agent: &str| -> String {
        let sql = format!("SELECT job_key FROM run_summary WHERE agent = '{agent}'");
        folder.store().query_one(&sql, [], |row| row.get(0)).unwrap()
    };
    folder.jitai(["export", "--policy", &key("plain"), "--out", "plain"]).succeeded();
    let about: serde_json::Value = serde_json::from_str(&folder.read("plain/policy.json")).unwrap();
    assert_eq!(
        about["network"],
        json!({
            "activation": "tanh",
            "stacks": [{ "hidden": ["policy_trunk.0", "policy_trunk.1"], "heads": ["logits"] }],
            "output": "logits",
        })
    );
    assert_eq!(about["choice"], json!({ "rule": "softmax" }));
    assert!(!fs::read(folder.path("plain/policy.onnx")).unwrap().is_empty());
    for (agent, output) in [("ppo-gru", "logits"), ("dqn-gru", "dueling")] {
        let key = key(agent);
        folder.jitai(["export", "--policy", &key, "--out", agent]).succeeded();
        let about = folder.read(&format!("{agent}/policy.json"));
        let about: serde_json::Value = serde_json::from_str(&about).unwrap();
        let network = &about["network"];
        assert_eq!(network["output"], output);
        let gru = json!({ "before": 1, "input": "gru_input", "state": "gru_hidden" });
        assert_eq!(network["stacks"][0]["gru"], gru);
        let policy = format!("run:{key}");
        folder.jitai(["simulate", "--policy", &policy, "--episodes", "2"]).succeeded();
    }
}

#[test]
fn every_format_numbers_a_name_that_occurs_again() {
    let folder = completed();
    let sql = "SELECT 1 AS value, 2 AS value, 3 AS Value, 4 AS value_2";
    let ask = |format: &str| folder.jitai(["query", sql, "--format", format]).succeeded();
    ask("table").prints("value  value_3  Value_4  value_2\n");
    ask("csv").prints("value,value_3,Value_4,value_2\n1,2,3,4\n");
    ask("json").prints(r#"{"value":1,"value_3":2,"Value_4":3,"value_2":4}"#);
    #[cfg(feature = "parquet")]
    {
        let output = folder.command(["query", sql, "--format", "parquet"]).output().unwrap();
        folder.write("answer.parquet", &output.stdout);
        let names: Vec<String> =
            parquet::read(&folder.path("answer.parquet")).0.into_iter().map(|c| c.0).collect();
        assert_eq!(names, ["value", "value_3", "Value_4", "value_2"]);
    }
}

#[cfg(feature = "parquet")]
mod parquet {
    use std::fs::File;
    use std::path::Path;

    use ::parquet::basic::Type;
    use ::parquet::file::reader::{FileReader, SerializedFileReader};

    use super::*;

    /// The columns of a file with their types, and the number of rows.
    pub(super) fn read(path: &Path) -> (Vec<(String, Type)>, i64) {
        let reader = SerializedFileReader::new(File::open(path).unwrap()).unwrap();
        let file = reader.metadata().file_metadata();
        let columns = file.schema_descr().columns().iter();
        let column = |one: &::parquet::schema::types::ColumnDescPtr| {
            (one.name().to_owned(), one.physical_type())
        };
        (columns.map(column).collect(), file.num_rows())
    }

    #[test]
    fn parquet_files_have_every_view_with_its_columns_types_and_rows() {
        let folder = completed();
        folder.jitai(["export", "--out", "results", "--format", "parquet"]).succeeded();
        let store = folder.store();
        for view in &views(&store) {
            let (found, rows) = read(&folder.path(&format!("results/{view}.parquet")));
            let names: Vec<&String> = found.iter().map(|(name, _)| name).collect();
            assert_eq!(names, columns(&store, view).iter().collect::<Vec<_>>(), "{view}");
            assert_eq!(rows, folder.number(&format!("SELECT count(*) FROM {view}")), "{view}");
        }
        let (found, _) = read(&folder.path("results/run_summary.parquet"));
        let kind = |name: &str| found.iter().find(|(known, _)| known == name).unwrap().1;
        assert_eq!(kind("job_key"), Type::BYTE_ARRAY);
        assert_eq!(kind("seed"), Type::INT64);
        assert_eq!(kind("mean_return"), Type::DOUBLE);
    }

    #[test]
    fn a_query_answers_in_parquet_on_standard_output() {
        let folder = completed();
        let sql = "SELECT agent, count(*) AS runs FROM run_summary GROUP BY agent";
        let output = folder.command(["query", sql, "--format", "parquet"]).output().unwrap();
        folder.write("answer.parquet", &output.stdout);
        let (found, rows) = read(&folder.path("answer.parquet"));
        let expected = [("agent".to_owned(), Type::BYTE_ARRAY), ("runs".to_owned(), Type::INT64)];
        assert_eq!((found, rows), (expected.to_vec(), 2));
    }

    #[test]
    fn columns_without_values_have_the_types_of_the_documentation() {
        let folder = completed();
        // Without decisions, participants and failures; and without any jobs.
        drop(jitai::store::Store::open(&folder.path("empty.sqlite")).unwrap());
        for store in ["jitai.sqlite", "empty.sqlite"] {
            let out = store.replace(".sqlite", "");
            let arguments = ["export", "--store", store, "--out", &out, "--format", "parquet"];
            folder.jitai(arguments).succeeded();
            for column in jitai::store::columns() {
                let jitai::store::ViewColumn { view, name, kind, .. } = column;
                let (found, _) = read(&folder.path(&format!("{out}/{view}.parquet")));
                let found = found.iter().find(|(known, _)| known == name).unwrap().1;
                let expected = match kind {
                    "integer" => Type::INT64,
                    "real" => Type::DOUBLE,
                    _ => Type::BYTE_ARRAY,
                };
                assert_eq!(found, expected, "{out}: {view}.{name}");
            }
        }
        let sql = "SELECT sigma AS s, min(seed), failure_kind, s.attempt FROM run_summary AS s \
                   WHERE seed = 77 GROUP BY 1, 3, 4";
        let output = folder.command(["query", sql, "--format", "parquet"]).output().unwrap();
        folder.write("answer.parquet", &output.stdout);
        let types: Vec<Type> =
            read(&folder.path("answer.parquet")).0.into_iter().map(|c| c.1).collect();
        let text = Type::BYTE_ARRAY;
        assert_eq!(types, [Type::DOUBLE, text, text, Type::INT64]);
    }
}

#[test]
fn tables_show_numbers_as_people_read_them_and_other_formats_every_digit() {
    let folder = completed();
    let query = [
        "query",
        "SELECT 0.1 + 0.2 AS sum, 1.0 / 3 AS third, 12345678901234.5 AS large, \
        1e-20 AS small",
    ];
    let table = folder.jitai(query).succeeded().stdout;
    let words: Vec<&str> = table.lines().nth(1).unwrap().split_whitespace().collect();
    assert_eq!(words, ["0.3", "0.333333333333", "12345678901234.5", "1e-20"]);
    let csv = folder.jitai(query.into_iter().chain(["--format", "csv"])).succeeded().stdout;
    let all = "0.30000000000000004,0.3333333333333333,12345678901234.5,1e-20";
    assert_eq!(csv, format!("sum,third,large,small\n{all}\n"));
    let json = folder.jitai(query.into_iter().chain(["--format", "json"])).succeeded().json();
    assert_eq!(json[0]["sum"], json!(0.1 + 0.2));
}

#[test]
fn tables_are_no_wider_than_columns() {
    let folder = completed();
    let text = "a text of several words that is long enough for two lines";
    let sql = format!("SELECT '{text}' AS one, '{text}' AS other");
    let widest = |columns: &str| {
        let mut command = folder.command(["query", &sql]);
        let output = command.env("COLUMNS", columns).output().unwrap();
        let table = String::from_utf8(output.stdout).unwrap();
        table.lines().map(|line| line.chars().count()).max().unwrap()
    };
    assert!((40..=60).contains(&widest("60")), "{}", widest("60"));
    // Without a number, and for columns too narrow to read, a table has its natural width.
    for columns in ["", "none", "0", "10"] {
        assert_eq!(widest(columns), 2 * text.len() + 2, "{columns}");
    }
}
