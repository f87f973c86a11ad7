//! Searches: the winner is printed as a table for other manifests, with its results on held-out seeds.

use crate::support::Folder;

const SEARCH: &str = r#"
format = 1
name = "search"
scenarios = ["P-H-D"]
seeds = [101, 102, 103]
environment.sigma = 0.6
environment.horizon = 10
evaluation.test_episodes = 20
[[agent]]
name = "learner"
label = "REINFORCE"
algorithm = "reinforce"
episodes = 200
gamma = 0.9
layers = [[8], [4, 4]]
learning_rate = [1e-6, 1e-2]
[[agent]]
name = "fixed"
algorithm = "rule"
rule = "random"
[[analysis]]
name = "chosen"
kind = "selection"
reporting_seeds = 4
"#;

/// The table that `report` prints below the path of its page.
fn winner(folder: &Folder) -> String {
    let answer = folder.jitai(["report", "search.toml", "--out", "report"]).succeeded();
    let (path, table) = answer.stdout.split_once("\n\n").unwrap();
    assert!(path.ends_with("index.html"), "{path}");
    assert_eq!(folder.read("report/tables/search-chosen.toml"), table);
    assert!(folder.read("report/index.html").contains("Best settings as TOML"));
    table.to_owned()
}

fn number(folder: &Folder, sql: &str) -> f64 {
    let answer = folder.jitai(["query", sql, "--format", "csv"]).succeeded();
    answer.stdout.lines().nth(1).unwrap().parse().unwrap()
}

#[test]
fn the_winner_of_a_search_is_a_table_for_another_manifest_with_its_held_out_results() {
    let folder = Folder::new();
    folder.write("search.toml", SEARCH);
    folder.jitai(["run", "search.toml"]).succeeded();
    let table = winner(&folder);
    assert!(
        table.contains("# Best of 4 settings tried, by the highest mean of mean return"),
        "{table}"
    );
    assert!(table.contains("# On held-out seeds: none of 4 completed"), "{table}");
    assert!(table.contains("\ngamma = 0.9\n"), "a key that was not searched: {table}");
    assert_eq!(table.matches("  # chosen\n").count(), 2, "{table}");
    // An agent with only one setting has no winner.
    assert_eq!(table.matches("[[agent]]").count(), 1, "{table}");

    // A preset with other settings changes nothing, because the table has every key.
    let head = "format = 1\nextends = \"paper\"\nname = \"final\"\nscenarios = [\"P-H-D\"]\nseeds = SEEDS\n\
                environment.sigma = 0.6\nenvironment.horizon = 10\nevaluation.test_episodes = 20\n\
                exclude = [{ agent.name = [\"dqn\", \"reinforce\"] }]\n";
    let again = head.replace("SEEDS", "[101, 102, 103]").replace("final", "again") + &table;
    folder.write("again.toml", again);
    folder.write("final.toml", head.replace("SEEDS", "3") + &table);
    let ran = folder.jitai(["run", "again.toml", "final.toml"]).succeeded();
    let shared = "SELECT count(*) AS n FROM (SELECT job_key FROM run_summary
        WHERE experiment IN ('search', 'again') GROUP BY job_key HAVING count(DISTINCT experiment) = 2)";
    assert_eq!(number(&folder, shared), 3.0, "{}", ran.stdout);

    let table = winner(&folder);
    let mean = |experiment: &str| {
        number(
            &folder,
            &format!(
                "SELECT avg(mean_return) AS mean FROM run_summary WHERE experiment = '{experiment}'"
            ),
        )
    };
    let (search, held_out) = (mean("again"), mean("final"));
    let line = |start: &str| {
        let found = table.lines().find_map(|line| line.strip_prefix(start));
        found.unwrap_or_else(|| panic!("{start} in {table}")).to_owned()
    };
    let first = |text: &str| -> f64 {
        text.split([' ', ',']).next().unwrap().replace('−', "-").parse().unwrap()
    };
    assert_eq!(first(&line("# On the seeds of the search: ")), search.round());
    let on_held_out = line("# On held-out seeds: ");
    assert_eq!(first(&on_held_out), held_out.round());
    assert!(on_held_out.ends_with("n = 3 of 4"), "{on_held_out}");
    let shrinkage = line(match held_out > search {
        true => "# No shrinkage: the held-out mean is higher by ",
        false => "# Expected shrinkage on new seeds, by the held-out mean: ",
    });
    assert!((first(&shrinkage) - (search - held_out).abs()).abs() <= 0.5, "{shrinkage}");
    assert!(shrinkage.contains("95 % interval"), "{shrinkage}");
}

#[test]
fn the_winner_is_among_the_analysed_jobs() {
    let folder = Folder::new();
    let text = SEARCH
        .replace("environment.sigma = 0.6", "environment.sigma = [0.2, 0.6]")
        .replace("gamma = 0.9", "gamma = [0.5, 0.9]")
        .replace("layers = [[8], [4, 4]]", "layers = [8]")
        + "where = { environment.sigma = 0.6, agent.gamma = 0.9 }\n";
    folder.write("search.toml", text);
    folder.jitai(["run", "search.toml"]).succeeded();
    let table = winner(&folder);
    assert!(table.contains("\ngamma = 0.9"), "{table}");
    assert!(table.contains("# Best of 2 settings tried"), "{table}");
    // Another experiment runs the held-out seeds at both sigmas; only the analysed sigma counts.
    let head = "format = 1\nname = \"final\"\nscenarios = [\"P-H-D\"]\nseeds = 4\n\
                environment.sigma = [0.2, 0.6]\nenvironment.horizon = 10\nevaluation.test_episodes = 20\n";
    folder.write("final.toml", head.to_owned() + &table);
    folder.jitai(["run", "final.toml"]).succeeded();
    let held_out = "SELECT avg(mean_return) AS mean FROM run_summary
        WHERE experiment = 'final' AND sigma = 0.6";
    let held_out = format!("# On held-out seeds: {:.0} ", number(&folder, held_out));
    let table = winner(&folder);
    assert!(table.contains(&held_out), "{held_out} in {table}");
}
