//! Which jobs run, and which do not run again.

use crate::support::{Effort, Folder, assert_same_rows, manifest};

/// Number of jobs of an experiment.
fn jobs_of(folder: &Folder, experiment: &str) -> i64 {
    let sql = "SELECT count(*) FROM run_summary WHERE experiment = ?1";
    folder.store().query_row(sql, [experiment], |row| row.get(0)).unwrap()
}

#[test]
fn a_second_run_runs_nothing_says_so_and_changes_no_row() {
    let folder = Folder::with(&manifest("sweep", "[0.4, 0.6]", "2", Effort::Trivial));
    folder
        .jitai(["run", "sweep.toml"])
        .succeeded()
        .says("8 jobs run, 8 completed in all, 0 failed");
    let after_one = folder.everything();
    assert_eq!(folder.number("SELECT count(*) FROM run_summary WHERE status = 'completed'"), 8);
    let second = folder.jitai(["run", "sweep.toml"]).succeeded();
    let second = second.says("nothing to run: all 8 jobs are completed");
    assert!(second.stdout.contains("mean return ± sd over seeds"), "{}", second.stdout);
    assert_eq!(folder.everything(), after_one);
}

#[test]
fn one_more_seed_runs_the_jobs_of_that_seed_alone() {
    let folder = Folder::completed(&manifest("sweep", "[0.4, 0.6]", "2", Effort::Trivial));
    let first_run = folder.number("SELECT max(id) FROM run");
    folder.write("sweep.toml", manifest("sweep", "[0.4, 0.6]", "3", Effort::Trivial));
    folder.jitai(["run", "sweep.toml"]).succeeded().says("4 jobs run, 12 completed in all");
    let new = format!(
        "SELECT count(*) FROM run JOIN job ON job.id = run.job
         WHERE run.id > {first_run} AND json_extract(canonical, '$.seed') = 3"
    );
    assert_eq!(folder.number(&new), 4);
    assert_eq!(folder.runs(), 12);
}

#[test]
fn new_names_order_comments_and_spelling_run_nothing() {
    let before = manifest("before", "[0.4, 0.6]", "2", Effort::Trivial);
    let folder = Folder::completed(&before);
    let (head, agents) = before.split_once("[[agent]]").unwrap();
    let (dqn, reinforce) = agents.split_once("[[agent]]").unwrap();
    let head = head
        .replace("before", "after")
        .replace("[0.4, 0.6]", "[ 6e-1, 0.400 ] # the middle ones")
        .replace("seeds = 2", "seeds = [2, 1]");
    let dqn = dqn.replace("\"dqn\"", "\"value learner\"");
    let after = format!("# Anew.\n{head}\n[[agent]]{reinforce}\n\n[[agent]]  {dqn}");
    folder.write("sweep.toml", &after);
    folder.jitai(["run", "sweep.toml"]).succeeded().says("nothing to run: all 8 jobs");
    assert_eq!(folder.runs(), 8);
    assert_eq!(jobs_of(&folder, "after"), 8);
    let named = "SELECT count(*) FROM run_summary WHERE experiment = 'after' \
                 AND agent = 'value learner'";
    assert_eq!(folder.number(named), 4);
}

#[test]
fn manifests_that_share_jobs_train_them_once() {
    for together in [true, false] {
        let folder = Folder::with(&manifest("narrow", "[0.4, 0.6]", "1", Effort::Trivial));
        folder.write("wide.toml", manifest("wide", "[0.6, 0.8]", "1", Effort::Trivial));
        if together {
            let plan = folder.jitai(["plan", "sweep.toml", "wide.toml"]).succeeded();
            plan.says("2 jobs are shared between the manifests and run once");
            folder.jitai(["run", "sweep.toml", "wide.toml"]).succeeded().says("6 jobs run");
        } else {
            folder.jitai(["run", "sweep.toml"]).succeeded().says("4 jobs run");
            folder.jitai(["run", "wide.toml"]).succeeded().says("2 jobs run, 4 completed");
        }
        assert_eq!(folder.runs(), 6);
        assert_eq!((jobs_of(&folder, "narrow"), jobs_of(&folder, "wide")), (4, 4));
    }
}

#[test]
fn an_edit_that_drops_jobs_keeps_their_runs() {
    let folder = Folder::completed(&manifest("sweep", "[0.4, 0.6]", "2", Effort::Trivial));
    let before = folder.dump();
    folder.write("sweep.toml", manifest("sweep", "0.6", "2", Effort::Trivial));
    let plan = |arguments: &[&str]| {
        folder.jitai(["plan", "sweep.toml"].iter().chain(arguments).copied()).succeeded()
    };
    for filter in [&[][..], &["--filter", "seed=1"]] {
        plan(filter).says("sweep has 4 jobs in the store that this manifest no longer has");
    }
    let narrowed = folder.jitai(["run", "sweep.toml"]).succeeded();
    for filter in [&[][..], &["--filter", "seed=1"]] {
        assert!(!plan(filter).stderr.contains("no longer has"));
    }
    narrowed.says("nothing to run: all 4 jobs").says("sweep no longer has 4 jobs that it had");
    assert_eq!(jobs_of(&folder, "sweep"), 4);
    assert_eq!(folder.number("SELECT count(DISTINCT job_key) FROM metric"), 8);
    let again = folder.jitai(["run", "sweep.toml"]).succeeded();
    assert!(!again.stderr.contains("no longer"), "{}", again.stderr);
    folder.write("sweep.toml", manifest("sweep", "[0.4, 0.6]", "2", Effort::Trivial));
    folder.jitai(["run", "sweep.toml"]).succeeded().says("nothing to run: all 8 jobs");
    assert_same_rows(&folder.dump(), &before);
    // The same jobs with another agent name.
    let renamed = manifest("sweep", "[0.4, 0.6]", "2", Effort::Trivial).replace("\"dqn\"", "\"q\"");
    folder.write("sweep.toml", &renamed);
    let renamed = folder.jitai(["run", "sweep.toml"]).succeeded();
    let renamed = renamed.says("nothing to run: all 8 jobs");
    assert!(!renamed.stderr.contains("no longer"), "{}", renamed.stderr);
    for style in [&["--quiet"][..], &["--format", "json"]] {
        folder.write("sweep.toml", manifest("sweep", "0.6", "1", Effort::Trivial));
        let refused = folder.jitai(["run", "sweep.toml"].iter().chain(style).copied()).ended(2);
        refused.says("add --replace to remove 6 of 8 jobs from sweep");
        let shard = folder.jitai(["run", "sweep.toml", "--shard", "1/2"]).ended(2);
        shard.says("add --replace to remove 6 of 8 jobs from sweep");
        assert_eq!(jobs_of(&folder, "sweep"), 8);
        let replacing = ["run", "sweep.toml", "--replace"];
        let run = folder.jitai(replacing.iter().chain(style).copied()).succeeded();
        run.says("sweep no longer has 6 jobs that it had");
        folder.write("sweep.toml", manifest("sweep", "[0.4, 0.6]", "2", Effort::Trivial));
        folder.jitai(["run", "sweep.toml"]).succeeded();
    }
}

#[test]
fn a_filter_runs_its_jobs_and_leaves_the_rest_for_later() {
    let folder = Folder::with(&manifest("sweep", "[0.4, 0.6]", "2", Effort::Trivial));
    let filtered = ["run", "sweep.toml", "--filter", "agent=dqn,sigma=0.6"];
    let first = folder.jitai(["run", "sweep.toml", "--filter", "agent=dqn,sigma=0.6,seed=2"]);
    let first = first.succeeded().prints("1 of 2");
    assert_eq!(first.stdout.matches("P-H-D").count(), 1, "{}", first.stdout);
    folder.jitai(filtered).succeeded().says("1 job run, 2 completed in all");
    let strangers = "SELECT count(*) FROM run_summary WHERE agent <> 'dqn' OR sigma <> 0.6";
    assert_eq!(folder.number(strangers), 0);
    folder.jitai(["run", "sweep.toml"]).succeeded().says("6 jobs run, 8 completed in all");
}

#[test]
fn the_store_is_where_the_option_or_the_environment_says() {
    let folder = Folder::with(&manifest("sweep", "0.6", "1", Effort::Trivial));
    folder.jitai(["run", "sweep.toml", "--store", "here.sqlite"]).succeeded();
    let mut named = folder.command(["run", "sweep.toml"]);
    let named = named.env("JITAI_STORE", "there.sqlite").output().unwrap();
    assert!(named.status.success(), "{named:?}");
    assert!(folder.path("here.sqlite").exists() && folder.path("there.sqlite").exists());
    assert!(!folder.path("jitai.sqlite").exists());
}

/// The commands that a run suggests after `next:`.
fn proposed(stdout: &[u8]) -> Vec<String> {
    let text = std::str::from_utf8(stdout).unwrap();
    let (_, next) = text.split_once("\nnext:\n").unwrap();
    next.lines().map(|line| line.trim().to_owned()).collect()
}

#[test]
fn the_query_that_a_run_proposes_has_a_row_for_every_arm() {
    let text = manifest("sweep", "[0.4, 0.6]", "2", Effort::Trivial)
        .replace("evaluation", "environment.delta_d = [0.1, 0.2]\nevaluation")
        .replace("layers = [32, 32]", "layers = [32, 32]\nlearning_rate = [1e-3, 5e-4]");
    let folder = Folder::with(&text);
    folder.write("other.toml", manifest("other", "0.6", "2", Effort::Trivial));
    for (manifests, columns, arms) in [
        (&["sweep.toml"][..], "agent,scenario,sigma,delta_d,learning_rate,avg(mean_return)", 12),
        (&["sweep.toml", "other.toml"], "experiment,agent,scenario,sigma,", 14),
    ] {
        let run = folder.jitai(["run"].into_iter().chain(manifests.iter().copied())).succeeded();
        let rows = run.stdout.lines().filter(|line| line.contains("P-H-D")).count();
        assert_eq!(rows, arms, "{}", run.stdout);
        let query = proposed(run.stdout.as_bytes()).remove(1);
        let query = query.replacen("jitai", "\"$0\"", 1) + " --format csv";
        let output =
            folder.command_of("sh", ["-c", &query, env!("CARGO_BIN_EXE_jitai")]).output().unwrap();
        let answer = String::from_utf8(output.stdout).unwrap();
        assert!(answer.starts_with(columns), "{answer}");
        assert_eq!(answer.lines().count(), 1 + arms, "{query}\n{answer}");
    }
}

#[test]
fn what_a_run_proposes_is_about_its_store_and_its_experiments() {
    let folder = Folder::with(&manifest("it's odd", "0.6", "2", Effort::Trivial));
    // The store's other experiment has jobs in the same arms.
    folder.write("other.toml", manifest("other", "0.6", "4", Effort::Trivial));
    for (variable, option, expected) in [
        (None, None, ""),
        (Some("there.sqlite"), None, ""),
        (None, Some("a b.sqlite"), " --store 'a b.sqlite'"),
        (Some("there.sqlite"), Some("jitai.sqlite"), " --store jitai.sqlite"),
        (Some("there.sqlite"), Some("there.sqlite"), ""),
    ] {
        let command = |arguments: &[&str]| {
            let mut command = folder.command(arguments.iter().copied());
            if let Some(variable) = variable {
                command.env("JITAI_STORE", variable);
            }
            command
        };
        let store: Vec<&str> = option.iter().flat_map(|path| ["--store", path]).collect();
        assert!(
            command(&[&["run", "other.toml"], &store[..]].concat()).status().unwrap().success()
        );
        let run = command(&[&["run", "sweep.toml"], &store[..]].concat()).output().unwrap();
        let proposed = proposed(&run.stdout);
        let verbs = ["status", "query", "export", "report", "simulate"];
        assert_eq!(proposed.len(), verbs.len(), "{proposed:?}");
        for (line, verb) in proposed.iter().zip(verbs) {
            let begins = format!("jitai {verb}{expected}");
            assert!(line.starts_with(&begins), "{line:?} does not begin with {begins:?}");
            // The command as a shell would run it.
            let line = line.replacen("jitai", "\"$0\"", 1);
            let mut shell = folder.command_of("sh", ["-c", &line, env!("CARGO_BIN_EXE_jitai")]);
            if let Some(variable) = variable {
                shell.env("JITAI_STORE", variable);
            }
            let output = shell.output().unwrap();
            assert!(output.status.success(), "{line}: {output:?}");
            if verb == "query" {
                let rows = String::from_utf8(output.stdout).unwrap();
                assert_eq!(rows.lines().count(), 3, "{rows}");
            }
        }
    }
}
