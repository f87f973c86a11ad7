//! Searches as races: what is planned, what runs, and what a report says of it.

use std::fs;

use serde_json::Value;

use crate::support::{Folder, assert_same_rows, until};

/// A race of four learning rates in two rungs, and an agent without draws.
const RACE: &str = r#"
format = 1
name = "race"
scenarios = ["P-H-D"]
environment.sigma = 0.6
environment.horizon = 10
evaluation.test_episodes = 20
[search]
samples = 4
rungs = [2, 4]
keep = 0.5
fresh = 3
[[agent]]
name = "drawn"
algorithm = "reinforce"
episodes = 200
layers = { choices = [[4], [8]] }
learning_rate = { log_uniform = [1e-6, 1e-2] }
[[agent]]
name = "declared"
algorithm = "reinforce"
episodes = 200
layers = [8]
"#;

/// 4 arms with 2 seeds, 2 of them with 2 more, the winner and the agent without draws with 3 fresh seeds.
const JOBS: i64 = 8 + 4 + 3 + 3;

fn folder(text: &str) -> Folder {
    Folder::with(text)
}

fn jobs(folder: &Folder, store: &str) -> i64 {
    let status = folder.jitai(["status", "--format", "json", "--store", store]).succeeded().json();
    status[0]["completed"].as_i64().unwrap()
}

#[test]
fn a_race_runs_to_its_end_and_says_before_it_how_long_it_can_be() {
    let folder = folder(RACE);
    folder
        .jitai(["check", "sweep.toml"])
        .succeeded()
        .prints("a race of 4 settings of drawn over up to 4 seeds, and 3 fresh seeds: 18 jobs\n");
    // 4 arms with 3 seeds, 2 of them with 1 more.
    let longer = ["check", "sweep.toml", "--set", "search.rungs=[3, 4]"];
    folder.jitai(longer).succeeded().prints("20 jobs");
    let plan = folder.jitai(["plan", "sweep.toml"]).succeeded();
    // The first rung, and the fresh seeds of the agent without draws.
    plan.says("11 jobs to run")
        .says("18 jobs")
        .says("rung 1 of 2: 4 of 4 arms open; next, the best 2 go on to 4 seeds");
    let ran = folder.jitai(["run", "sweep.toml"]).succeeded();
    ran.says("rung 2 of 2: 2 of 2 arms open; next, the best gets 3 fresh seeds")
        .says("18 jobs run, 18 completed in all");
    assert_eq!(jobs(&folder, "jitai.sqlite"), JOBS);
    let again = folder.jitai(["run", "sweep.toml"]).succeeded();
    again.says("nothing to run: all 18 jobs are completed").says("has won");
    folder.jitai(["plan", "sweep.toml"]).succeeded().says("nothing to run");
}

#[test]
fn a_failure_that_stops_the_sweep_starts_no_next_stage() {
    let layers = ["64"; 24].join(", ");
    let wild =
        format!("algorithm = \"dueling_dqn\"\nbatch = 8\nlearning_rate = 1.0\nlayers = [{layers}]");
    let text = RACE.replace("fresh = 3", "fresh = 1");
    let folder =
        folder(&text.replace("algorithm = \"reinforce\"\nepisodes = 200\nlayers = [8]", &wild));
    // The last job of the first stage fails, so the stage has no job left.
    let run = ["run", "sweep.toml", "--workers", "1", "--fail-fast"];
    folder.jitai(run).ended(1).says(
        "9 jobs run, 8 completed in all, 1 failed; halted after the first failure, before the next stage",
    );
    assert_eq!(folder.runs(), 9);
    folder.jitai(["run", "sweep.toml"]).ended(1).says("has won");
    assert_eq!(folder.runs(), 14);
}

#[test]
fn check_gives_the_least_and_the_most_where_evidence_decides() {
    let text = RACE.replace("keep = 0.5", "level = 0.05");
    // 4 × 2 + 3 + 3 jobs if three arms leave at once, 4 × 4 + 3 + 3 if none leaves.
    let check = folder(&text).jitai(["check", "sweep.toml"]).succeeded();
    check.prints("3 fresh seeds: at least 14 and at most 22 jobs");
}

#[test]
fn a_killed_race_comes_to_the_same_end() {
    let long = RACE.replace("episodes = 200", "episodes = 6_000");
    let killed = folder(&long);
    let run = killed.start(["run", "sweep.toml", "--workers", "1"]);
    until("a job has ended", || {
        killed.count_if_there("SELECT count(*) FROM run WHERE status = 'completed'") > Some(2)
    });
    run.kill();
    killed.jitai(["run", "sweep.toml"]).succeeded().says("has won");
    assert_same_rows(&killed.dump(), &Folder::completed(&long).dump());
}

#[test]
fn a_race_in_merged_shards_is_the_race_of_one_machine() {
    let merged = folder(RACE);
    for stage in 0..3 {
        for shard in ["1/2", "2/2"] {
            let store = format!("{}.sqlite", &shard[..1]);
            let run = ["run", "sweep.toml", "--shard", shard, "--store", &store];
            let ended = merged.jitai(run).succeeded();
            if stage == 0 {
                ended.says("other jobs of this stage are not part of this command");
            }
        }
        merged.jitai(["merge", "1.sqlite", "2.sqlite"]).succeeded();
        for store in ["1.sqlite", "2.sqlite"] {
            fs::copy(merged.path("jitai.sqlite"), merged.path(store)).unwrap();
        }
    }
    assert_eq!(jobs(&merged, "jitai.sqlite"), JOBS);
    merged.jitai(["run", "sweep.toml"]).succeeded().says("nothing to run");
    assert_same_rows(&merged.dump(), &Folder::completed(RACE).dump());
}

#[test]
fn more_samples_run_only_what_they_add() {
    let folder = Folder::completed(RACE);
    folder.write("sweep.toml", RACE.replace("samples = 4", "samples = 6"));
    // The first rung of two more arms; which arms go on follows from their results.
    folder.jitai(["plan", "sweep.toml"]).succeeded().says("4 jobs to run");
}

#[test]
fn status_and_watch_say_where_a_race_stands_and_what_comes_next() {
    let folder = folder(RACE);
    folder.jitai(["run", "sweep.toml", "--shard", "1/2"]).succeeded();
    let race = |folder: &Folder| {
        let status = folder.jitai(["status", "--format", "json"]).succeeded().json();
        status[0]["races"][0].clone()
    };
    let first = race(&folder);
    let open = first["arms_open"].as_u64().unwrap();
    assert!((1..=4).contains(&open), "{first}");
    let state = format!("rung 1 of 2: {open} of 4 arms open; next, the best 2 go on to 4 seeds");
    assert_eq!(
        (&first["rung"], &first["arms_left"], &first["winner"]),
        (&1.into(), &4.into(), &Value::Null)
    );
    assert_eq!(first["state"], state);
    folder.jitai(["status"]).succeeded().prints("\nraces:\n").prints(&state);

    folder.jitai(["run", "sweep.toml"]).succeeded();
    let last = race(&folder);
    let won = format!("arm {} of 4 has won", last["winner"]);
    assert_eq!((&last["state"], &last["fresh_seeds_open"]), (&won.as_str().into(), &0.into()));
    folder.jitai(["status"]).succeeded().prints(&won);
    folder.jitai(["watch"]).succeeded().prints(&format!("\n  drawn: {won}\n"));
}

#[test]
fn the_report_has_the_race_and_its_winner_for_another_manifest() {
    let folder = Folder::completed(RACE);
    let answer = folder.jitai(["report", "sweep.toml", "--out", "report"]).succeeded();
    let (_, winner) = answer.stdout.split_once("\n\n").unwrap();
    assert_eq!(folder.read("report/tables/race-race.toml"), winner);
    for line in [
        "# Race of experiment `race`: drawn\n",
        "# Best of 4 settings drawn, by the mean of mean return per episode, steps walked\n",
        "# On 3 fresh seeds shared with declared, winner minus declared: ",
        "# The race took 12 jobs and 75 % of the work of a grid of its settings with all of its seeds, which has 16 jobs\n",
    ] {
        assert!(winner.contains(line), "{line} in {winner}");
    }
    assert_eq!(winner.matches("  # chosen\n").count(), 2, "{winner}");
    let rows = folder.read("report/tables/race-race.csv");
    let ends = |end: &str| rows.lines().filter(|row| row.contains(end)).count();
    assert_eq!((rows.lines().count(), ends("has won")), (5, 1), "{rows}");
    assert_eq!(
        (ends("not among the best of 4"), ends("not among the best of 2")),
        (2, 1),
        "{rows}"
    );
    // The means after both rungs, which the figure draws; two arms have left after the first.
    assert!(rows.starts_with("agent,arm,settings,rung,seeds,mean,"), "{rows}");
    assert!(rows.lines().next().unwrap().ends_with(",end,mean_2,mean_4"), "{rows}");
    assert_eq!(rows.lines().filter(|row| row.ends_with(',')).count(), 2, "{rows}");
    let page = folder.read("report/index.html");
    assert!(page.contains("The race") && page.contains("seeds per arm"));
    assert!(!answer.stderr.contains("no figures"), "{}", answer.stderr);
    let svg = folder.read("report/figures/race-race-drawn.svg");
    assert_eq!(svg.matches(">declared, fresh<").count(), 1, "{svg}");
    for extension in ["pdf", "png"] {
        assert!(folder.path(&format!("report/figures/race-race-drawn.{extension}")).exists());
    }

    // The winner's return on the fresh seeds, as SQL finds it.
    let sql = "SELECT avg(mean_return) FROM run_summary WHERE agent = 'drawn' AND seed > 4";
    let answer = folder.jitai(["query", sql, "--format", "csv"]).succeeded();
    let mean: f64 = answer.stdout.lines().nth(1).unwrap().parse().unwrap();
    assert!(
        winner.contains(&format!("# On fresh seeds: {mean:.0} (95 % interval")),
        "{mean} {winner}"
    );

    // Another manifest with the winner shares its jobs.
    let head = RACE.split("[search]").next().unwrap().replace("\"race\"", "\"other\"");
    folder.write(
        "other.toml",
        format!("{head}\n{winner}").replace("scenarios", "seeds = 2\nscenarios"),
    );
    folder.jitai(["run", "other.toml"]).succeeded().says("all 2 jobs are completed");
}
