//! The public views: the promises of `docs/store.md`, the speed of finding one job, and the size.

use std::fs;
use std::path::Path;

use jitai::job::Job;
use jitai::job::Outcome;
use jitai::store::VIEWS;
use rusqlite::Connection;

use super::sample::{Sample, completed, dqn, failed, number, realistic, reinforce, results};

fn documentation() -> String {
    fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/store.md")).unwrap()
}

#[test]
fn the_documented_queries_run_and_there_is_one_for_each_view() {
    let sample = Sample::with(&[dqn(0.4, 1)]);
    let raw = sample.raw();
    let text = documentation();
    let queries: Vec<&str> =
        text.split("```sql\n").skip(1).map(|rest| rest.split("```").next().unwrap()).collect();
    assert_eq!(queries.len(), VIEWS.len());
    for (view, sql) in VIEWS.iter().zip(queries) {
        assert!(sql.contains(view), "the example of {view}:\n{sql}");
        let mut statement = raw.prepare(sql).unwrap_or_else(|error| panic!("{sql}\n{error}"));
        assert!(statement.query([]).unwrap().next().is_ok(), "{sql}");
    }
}

#[test]
fn the_views_show_what_was_stored() {
    let job = dqn(0.4, 7);
    let mut sample = Sample::with(std::slice::from_ref(&job));
    sample.run(&job, &completed());
    let raw = sample.raw();
    let line = |sql: &str| raw.query_row(sql, [], |row| row.get::<_, String>(0)).unwrap();
    assert_eq!(
        line(
            "SELECT concat_ws(' ', experiment, agent, scenario, sigma, seed, status, attempt,
                mean_return, sd_return, mean_length, disengagement_rate, wall_seconds, code_version)
             FROM run_summary"
        ),
        "sweep dqn P-H-D 0.4 7 completed 1 1.0 2.0 4.0 5.0 1.5 0.1.0"
    );
    assert_eq!(line("SELECT job_key FROM run_summary"), job.key().to_string());
    assert_eq!(
        line("SELECT group_concat(name || ' ' || value, ', ' ORDER BY value) FROM metric"),
        "mean_return 1.0, sd_return 2.0, mean_net_return 3.0, mean_length 4.0, disengagement_rate 5.0, \
         message_rate 6.0"
    );
    assert_eq!(
        line("SELECT concat_ws(' ', episode, metric, value) FROM learning_curve"),
        "10 mean_return 7.5"
    );
    assert_eq!(
        line(
            "SELECT concat_ws(' ', total_reward, length, disengaged)
             FROM evaluation_episode WHERE episode = 2"
        ),
        "310.0 7 1"
    );
    assert_eq!(
        line("SELECT concat_ws(' ', p_low, p_high, context, action, count) FROM action_choice"),
        "0.9 1.0 0 2 17"
    );
    assert_eq!(line("SELECT value FROM parameter WHERE name = 'agent.layers'"), "[128,128]");
}

#[test]
fn the_standard_deviation_of_one_episode_is_null_although_the_file_has_a_number() {
    let job = dqn(0.4, 7);
    let mut sample = Sample::with(std::slice::from_ref(&job));
    let mut one = results();
    one.episodes.truncate(1);
    // What earlier releases stored.
    one.metrics[1].value = 0.0;
    sample.run(&job, &Outcome::Completed(one.clone()));
    let raw = sample.raw();
    let stored = "SELECT count(*) FROM run_metric WHERE value = 0.0";
    assert_eq!(number(&raw, stored), 1);
    for undefined in [
        "run_summary WHERE sd_return IS NULL AND mean_return = 1.0",
        "arm_summary WHERE sd_return IS NULL AND mean_return = 1.0",
        "metric WHERE name = 'sd_return' AND value IS NULL",
    ] {
        assert_eq!(number(&raw, &format!("SELECT count(*) FROM {undefined}")), 1, "{undefined}");
    }
    assert_eq!(number(&raw, "SELECT count(*) FROM metric WHERE value IS NULL"), 1);
    // Today's results, which do not have the metric, have the same digest.
    let mut today = Sample::with(std::slice::from_ref(&job));
    one.metrics.remove(1);
    today.run(&job, &Outcome::Completed(one));
    let digest = |raw: &Connection| {
        let sql = "SELECT hex(results_sha256) FROM run";
        raw.query_row(sql, [], |row| row.get::<_, String>(0)).unwrap()
    };
    assert_eq!(digest(&raw), digest(&today.raw()));
}

#[test]
fn runs_that_did_not_complete_are_in_the_summary_alone() {
    let job = dqn(0.4, 1);
    let mut sample = Sample::with(std::slice::from_ref(&job));
    sample.run(&job, &Outcome::Interrupted);
    sample.run(&job, &failed());
    let raw = sample.raw();
    let failure = "SELECT count(*) FROM run_summary WHERE (failure_kind, failure_message)
        IS (iif(status = 'failed', 'diverged', NULL),
            iif(status = 'failed', 'the loss is not a number', NULL))";
    assert_eq!(number(&raw, failure), 2);
    let statuses = "SELECT count(*) FROM run_summary
        WHERE (attempt, status) IN (VALUES (1, 'interrupted'), (2, 'failed'))
            AND mean_return IS NULL AND ended_at >= started_at";
    assert_eq!(number(&raw, statuses), 2);
    for view in ["metric", "learning_curve", "evaluation_episode", "action_choice"] {
        assert_eq!(number(&raw, &format!("SELECT count(*) FROM {view}")), 0, "{view}");
    }
}

#[test]
fn a_run_without_a_heartbeat_does_not_show_as_running() {
    let job = dqn(0.4, 1);
    let mut sample = Sample::with(std::slice::from_ref(&job));
    sample.claim(&job);
    let raw = sample.raw();
    let status = || {
        raw.query_row("SELECT status FROM run_summary", [], |row| row.get::<_, String>(0)).unwrap()
    };
    assert_eq!(status(), "running");
    for (ago, expected) in [("-25 seconds", "running"), ("-35 seconds", "interrupted")] {
        let beat = "UPDATE session SET heartbeat_at = strftime('%Y-%m-%dT%H:%M:%fZ', 'now', ?1)";
        raw.execute(beat, [ago]).unwrap();
        assert_eq!(status(), expected);
    }
    sample.store.heartbeat(sample.session).unwrap();
    assert_eq!(status(), "running");
}

#[test]
fn one_job_is_found_in_every_view_without_reading_the_others() {
    let sample = Sample::new();
    let raw = sample.raw();
    // arm_summary and manifest depend on all jobs of an experiment.
    for view in VIEWS.into_iter().filter(|view| !["arm_summary", "manifest"].contains(view)) {
        let mut statement = raw
            .prepare(&format!("EXPLAIN QUERY PLAN SELECT * FROM {view} WHERE job_key = ?1"))
            .unwrap();
        let steps: Vec<String> = statement
            .query_map(["0"], |row| row.get(3))
            .unwrap()
            .collect::<Result<_, _>>()
            .unwrap();
        // The parameters of the job are read from its own text, and from the few parameters that all
        // jobs have; both come through a co-routine with the name of the view, and so do
        // decisions and choices of action. A row of decisions has ten places.
        let read = [
            "SCAN tree VIRTUAL",
            "SCAN implied",
            "SCAN parameter",
            "SCAN decision",
            "SCAN action_choice",
            "SCAN place",
            "SCAN 10 CONSTANT ROWS",
        ];
        let scans: Vec<_> = steps
            .iter()
            .filter(|step| {
                step.starts_with("SCAN") && !read.iter().any(|few| step.starts_with(few))
            })
            .collect();
        assert!(scans.is_empty(), "{view}: {steps:#?}");
        assert!(
            steps.iter().any(|step| step.starts_with("SEARCH job USING")),
            "{view}: {steps:#?}"
        );
    }
}

#[test]
fn the_whole_paper_fits_in_150_megabytes() {
    let jobs: Vec<Job> = (1..=10).flat_map(|seed| [dqn(0.4, seed), reinforce(0.4, seed)]).collect();
    let mut sample = Sample::with(&jobs);
    for job in &jobs {
        sample.run(job, &Outcome::Completed(realistic(job)));
    }
    let bytes = number(
        &sample.raw(),
        "SELECT page_count * page_size FROM pragma_page_count, pragma_page_size",
    );
    let paper = bytes * 350 / jobs.len() as i64;
    assert!(paper < 150_000_000, "the paper would take {paper} bytes");
}
