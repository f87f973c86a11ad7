//! Reports: equal stores give equal bytes, and the report states what is missing.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use rusqlite::Connection;

use crate::support::{Effort, Folder, manifest};

/// Analyses of every kind, on jobs of milliseconds.
const MANIFEST: &str = r#"
format = 1
name = "every <kind>"
question = "Is </script><b>this</b> shown as it is written?"
scenarios = ["P-H-D", "L-H-D"]
seeds = [11, 12]
published = "published.csv"
environment.sigma = [0.4, 0.6]
environment.delta_d = [0.1, 0.2]
environment.horizon = 10
evaluation.test_episodes = 20
[[agent]]
name = "=dqn&co"
algorithm = "dueling_dqn"
episodes = 40
layers = [8]
[[agent]]
name = "reinforce"
algorithm = "reinforce"
episodes = 200
layers = [8]
[[analysis]]
name = "../../gain"
kind = "contrast"
by = "scenario"
between = ["P-H-D", "L-H-D"]
pairing = "by_seed"
[[analysis]]
name = "curve"
kind = "curve"
metric = "lower_quartile_return"
[[analysis]]
name = "learning"
kind = "learning_curve"
window = 20
where = { environment.delta_d = 0.1, environment.sigma = 0.6 }
[[analysis]]
name = "map"
kind = "heat_map"
x = "environment.sigma"
y = "environment.delta_d"
[[analysis]]
name = "choices"
kind = "action_choice"
[[analysis]]
name = "error"
kind = "inference_error"
"#;

const PUBLISHED: &str = "sigma,metric,value,n\n0.4,context_inference_error,0.096,1000\n";

fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_str().unwrap().to_owned();
        if path.is_dir() {
            let inner = files(&path).into_iter();
            found.extend(inner.map(|(below, bytes)| (format!("{name}/{below}"), bytes)));
        } else {
            found.insert(name, fs::read(path).unwrap());
        }
    }
    found
}

fn prepared() -> Folder {
    let folder = Folder::with(MANIFEST);
    folder.write("published.csv", PUBLISHED);
    folder
}

#[test]
fn two_reports_of_one_store_are_equal_to_the_byte_and_hold_every_analysis() {
    let folder = prepared();
    folder.jitai(["run", "sweep.toml"]).succeeded();
    for out in ["one/report", "two/report"] {
        folder.jitai(["report", "sweep.toml", "--out", out]).succeeded();
    }
    let one = files(&folder.path("one"));
    assert_eq!(one, files(&folder.path("two")));
    let names: Vec<&String> = one.keys().collect();
    let stem = "report/tables/every-kind-gain.csv";
    assert!(one.contains_key(stem), "{names:?}");
    assert!(one.contains_key("report/reproduction.csv"), "{names:?}");
    let drawn = names.iter().filter(|name| name.ends_with(".png")).count();
    assert_eq!(drawn, names.iter().filter(|name| name.ends_with(".svg")).count());
    assert_eq!(drawn, names.iter().filter(|name| name.ends_with(".pdf")).count());
    // A combined figure adds one to its panels, and choices of 16 arms make two: gain, choices, learning, curve,
    // map, error.
    assert_eq!(drawn, 1 + 18 + 3 + 3 + 5 + 1, "{names:?}");
    for stem in ["gain", "curve", "choices", "choices-part-2", "learning", "error"] {
        let name = format!("report/figures/every-kind-{stem}.pdf");
        assert!(one.get(&name).is_some_and(|bytes| bytes.starts_with(b"%PDF-1.4")), "{names:?}");
    }
    assert!(one.contains_key("report/figures/every-kind-choices-part-2.svg"), "{names:?}");
    let page = String::from_utf8(one["report/index.html"].clone()).unwrap();
    let captions: Vec<&str> = page.split("<p class=\"seen\">").skip(1).collect();
    assert_eq!(captions.len(), 6, "a caption for every kind");
    for caption in captions {
        let caption = caption.split("</p>").next().unwrap().trim_end_matches("</span>");
        let sentences = caption.matches(". ").count() + 1;
        assert!((1..=3).contains(&sentences) && caption.ends_with('.'), "{caption}");
    }
    assert!(!page.contains("</script><b>") && !page.contains("every <kind>"));
    assert!(
        !page.contains("http://")
            || page.matches("http://").count()
                == page.matches("http://www.w3.org/2000/svg").count()
    );
    let table = String::from_utf8(one[stem].clone()).unwrap();
    assert!(table.contains("'=dqn&co"), "{table}");
    assert!(!page.contains("NaN") && !table.contains("NaN"));
    let text = |name: &str| String::from_utf8(one[name].clone()).unwrap();
    let paired = text("report/tables/every-kind-gain.md");
    assert!(
        paired.contains(
            ": mean return per episode, steps walked; t test paired by seed; Holm’s correction"
        ),
        "{paired}"
    );
    let manual = include_str!("../../docs/report.md");
    for name in names.iter().filter(|name| name.starts_with("report/tables/")) {
        let Some(header) = name.ends_with(".csv").then(|| text(name)) else { continue };
        for column in header.lines().next().unwrap().split(',') {
            assert!(manual.contains(&format!("`{column}`")), "{name}: {column}");
        }
    }
}

/// Rules alone, whose jobs take milliseconds.
const RULES: &str = r#"
format = 1
name = "r"
scenarios = ["P-H-D", "L-H-D"]
seeds = 3
environment.sigma = [0.4, 0.6, 0.8]
environment.horizon = 10
evaluation.test_episodes = 20
[[agent]]
name = "tailored"
algorithm = "rule"
rule = "tailored"
[[agent]]
name = "random"
algorithm = "rule"
rule = "random"
"#;

/// The files of the report of a manifest, and what `jitai report` writes on standard error.
fn reported(folder: &Folder) -> (BTreeMap<String, Vec<u8>>, String) {
    folder.jitai(["run", "sweep.toml"]).succeeded();
    let told = folder.jitai(["report", "sweep.toml", "--out", "report"]);
    let told = told.succeeded().stderr;
    (files(&folder.path("report")), told)
}

#[test]
fn analyses_named_like_tables_of_the_report_replace_no_file() {
    let analysis = |name: &str, keys: &str| format!("[[analysis]]\nname = \"{name}\"\n{keys}\n");
    let curve = "kind = \"curve\"\nx = \"environment.sigma\"\npanel = \"scenario\"";
    let folder = Folder::with(&format!(
        "{RULES}{}{}{}{}{}",
        analysis("arms", curve),
        analysis("Agents", curve),
        analysis("arms-2", curve),
        // The stems of its panels are the stems of the analyses before.
        analysis("ARMS", curve),
        analysis("arms-p-h-d", curve),
    ));
    let (files, _) = reported(&folder);
    let names: Vec<&String> = files.keys().collect();
    let lower: std::collections::BTreeSet<String> =
        names.iter().map(|name| name.to_lowercase()).collect();
    assert_eq!(lower.len(), names.len());
    // Two tables of arms, and one of each analysis.
    let count = |start: &str, end: &str| {
        names.iter().filter(|name| name.starts_with(start) && name.ends_with(end)).count()
    };
    assert_eq!(count("tables/", ".csv"), 2 + 5, "{names:?}");
    assert_eq!(count("sql/", ".sql"), 5);
    // Two panels and one figure of both.
    assert_eq!(count("figures/", ".svg"), 5 * 3, "{names:?}");
    let header = |name: &str| {
        let text = String::from_utf8(files[name].clone()).unwrap();
        text.lines().next().unwrap().to_owned()
    };
    assert!(header("tables/r-arms.csv").contains("interquartile_mean"));
    assert!(header("tables/r-agents.csv").contains("scenario"));
    assert!(header("tables/r-arms-2.csv").contains("parameter"));
    let page = String::from_utf8(files["index.html"].clone()).unwrap();
    let ids: Vec<&str> =
        page.split(" id=\"").skip(1).map(|rest| rest.split('"').next().unwrap()).collect();
    let distinct: std::collections::BTreeSet<&&str> = ids.iter().collect();
    assert_eq!(distinct.len(), ids.len(), "{ids:?}");
    for link in page.split("href=\"").skip(1).map(|rest| rest.split('"').next().unwrap()) {
        let is_known = match link.strip_prefix('#') {
            Some(anchor) => ids.contains(&anchor),
            None => link.starts_with("data:") || files.contains_key(link),
        };
        assert!(is_known, "{link}");
    }
}

#[test]
fn choices_of_action_have_a_file_per_arm_and_stand_two_in_a_row() {
    let folder = Folder::with(&format!(
        "{RULES}[[analysis]]\nname = \"choice\"\nkind = \"action_choice\"\n"
    ));
    let (files, _) = reported(&folder);
    let svg =
        |stem: &str| String::from_utf8(files[&format!("figures/{stem}.svg")].clone()).unwrap();
    let size = |stem: &str| {
        let text = svg(stem);
        let length = |name: &str| -> f64 {
            let rest = text.split(&format!(" {name}=\"")).nth(1).unwrap();
            let number: String =
                rest.chars().take_while(|c| c.is_ascii_digit() || *c == '.').collect();
            number.parse().unwrap()
        };
        (length("width"), length("height"))
    };
    let panels = files.keys().filter(|name| name.starts_with("figures/") && name.ends_with(".svg"));
    assert_eq!(panels.count(), 12 + 1);
    let (one, all) = (size("r-choice-tailored-p-h-d-sigma-0-4"), size("r-choice"));
    assert!(
        (all.0 / one.0 - 2.0).abs() < 0.01 && (all.1 / one.1 - 6.0).abs() < 0.01,
        "{one:?} {all:?}"
    );
}

#[test]
fn a_report_without_analyses_says_that_it_has_no_figures() {
    let folder = Folder::with(RULES);
    let (files, told) = reported(&folder);
    assert!(told.contains("note: no figures of r, because it declares no [[analysis]]"), "{told}");
    let page = String::from_utf8(files["index.html"].clone()).unwrap();
    assert!(page.contains("There are no figures, because the manifest declares no"));
    assert!(!files.keys().any(|name| name.starts_with("figures/")));
}

#[test]
fn a_curve_draws_an_arm_that_lacks_its_key_across() {
    let folder = Folder::with(&format!(
        "{RULES}[[agent]]\nname = \"rf\"\nalgorithm = \"reinforce\"\nepisodes = 20\nlayers = [4]\n\
         learning_rate = [1e-300, 0.001, 0.1]\n[[analysis]]\nname = \"rates\"\nkind = \"curve\"\n\
         x = \"agent.learning_rate\"\nwhere = {{ environment.sigma = 0.4 }}\n",
    ));
    let (files, _) = reported(&folder);
    let table = String::from_utf8(files["tables/r-rates.csv"].clone()).unwrap();
    let across = table.lines().filter(|line| line.contains(" P-H-D,,,3,"));
    assert_eq!(across.count(), 2, "{table}");
    let svg = String::from_utf8(files["figures/r-rates.svg"].clone()).unwrap();
    for label in ["1e-300", "0.001", "0.1", "tailored P-H-D", "random L-H-D"] {
        assert!(svg.contains(label), "{label}");
    }
}

#[test]
fn the_query_beside_a_figure_reads_its_rows() {
    let folder = prepared();
    folder.jitai(["run", "sweep.toml"]).succeeded();
    folder.jitai(["report", "sweep.toml", "--out", "report"]).succeeded();
    for (name, bytes) in files(&folder.path("report/sql")) {
        let sql = String::from_utf8(bytes).unwrap();
        let answer = folder.jitai(["query", &sql, "--format", "csv"]).succeeded();
        let rows = answer.stdout.lines().count() - 1;
        assert!(rows > 0, "{name}: {sql}");
        // 2 agents, 2 scenarios, 2 sigmas, 2 values of delta_d and 2 seeds.
        if ["every-kind-gain.sql", "every-kind-map.sql"].contains(&&*name) {
            assert_eq!(rows, 32, "{name}: {sql}");
        }
    }
}

/// Rules in three scenarios and at three sigmas, of which contrasts and maps compare two.
const SIDES: &str = r#"
format = 1
name = "sides"
scenarios = ["P-H-D", "L-H-D", "P-T"]
seeds = 2
environment.sigma = [0.4, 0.6, 0.8]
environment.delta_d = [0.1, 0.2]
environment.horizon = 10
evaluation.test_episodes = 20
[[agent]]
name = "never"
algorithm = "rule"
rule = "never"
[[agent]]
name = "untailored"
algorithm = "rule"
rule = "untailored"
[[agent]]
name = "chance"
algorithm = "rule"
rule = "random"
[[analysis]]
name = "scenario"
kind = "contrast"
by = "scenario"
between = ["P-H-D", "P-T"]
where = { agent.name = "never" }
[[analysis]]
name = "agent"
kind = "contrast"
by = "agent.name"
between = ["untailored", "never"]
[[analysis]]
name = "key"
kind = "contrast"
by = "environment.sigma"
between = [0.8, 0.4]
[[analysis]]
name = "map"
kind = "heat_map"
x = "environment.sigma"
y = "environment.delta_d"
by = "scenario"
between = ["P-H-D", "L-H-D"]
"#;

#[test]
fn the_query_beside_a_difference_reads_its_sides_alone() {
    let folder = Folder::completed(SIDES);
    folder.jitai(["report", "sweep.toml", "--out", "report"]).succeeded();
    // 3 scenarios, 3 agents, 3 sigmas, 2 values of delta_d and 2 seeds: 108 jobs.
    for (name, rows) in [("scenario", 24), ("agent", 72), ("key", 72), ("map", 72)] {
        let sql = folder.read(&format!("report/sql/sides-{name}.sql"));
        let answer = folder.jitai(["query", &sql, "--format", "csv"]).succeeded();
        assert_eq!(answer.stdout.lines().count() - 1, rows, "{name}: {sql}");
    }
    // The store still has the jobs of the unchanged manifest.
    folder.write("sweep.toml", SIDES.replace("seeds = 2", "seeds = 1"));
    folder.jitai(["report", "sweep.toml", "--out", "report"]).succeeded();
    let sql = folder.read("report/sql/sides-map.sql");
    assert!(sql.starts_with("/* The jobs of the manifest have changed since"), "{sql}");
    folder.jitai(["query", &sql]).succeeded();
}

#[test]
fn a_partial_store_gives_a_report_that_says_what_is_missing() {
    let folder = prepared();
    folder.jitai(["run", "sweep.toml", "--filter", "agent=reinforce,seed=11"]).succeeded();
    let report = folder.jitai(["report", "sweep.toml", "--out", "report"]).succeeded();
    report.says("note: 24 of 32 jobs of every <kind> have no completed run\n");
    let page = folder.read("report/index.html");
    assert!(page.contains("This report is partial: 8 of 32 jobs completed"), "{page}");
    assert!(page.contains("no seed completed") || page.contains("too few seeds"));
    assert!(!page.contains("NaN"));
}

#[test]
fn a_report_needs_a_store_and_readable_published_numbers() {
    let folder = prepared();
    assert_eq!(folder.jitai(["report", "sweep.toml", "--out", "report"]).code, Some(3));
    folder.write("published.csv", "agent,value,n\n1,none,3\n");
    let told = folder.jitai(["report", "sweep.toml", "--out", "report"]);
    assert_eq!(told.code, Some(2));
    assert!(told.stderr.contains("published numbers cannot be read"), "{}", told.stderr);
    folder.jitai(["check", "sweep.toml"]).ended(2).says("published.csv:2:1: ");
    std::fs::remove_file(folder.path("published.csv")).unwrap();
    for command in [&["check", "sweep.toml"][..], &["report", "sweep.toml", "--out", "report"]] {
        folder.jitai(command.iter().copied()).ended(2).says("sweep.toml:").says("`published`: ");
    }
}

#[test]
fn a_caption_names_no_trend_where_there_is_none() {
    let manifest = "format = 1\nname = \"rules\"\nscenarios = [\"P-H-D\", \"L-H-D\"]\nseeds = 2\n\
                    environment.sigma = [0.4, 0.8]\nevaluation.test_episodes = 20\n\
                    [[agent]]\nname = \"never\"\nalgorithm = \"rule\"\nrule = \"never\"\n\
                    [[analysis]]\nname = \"returns\"\nkind = \"curve\"\n";
    let folder = Folder::with(manifest);
    let report = || {
        folder.jitai(["report", "sweep.toml", "--out", "report"]).succeeded();
        folder.read("report/index.html")
    };
    for filter in ["environment.sigma=0.8", "agent=never"] {
        folder.jitai(["run", "sweep.toml", "--filter", filter]).succeeded();
        let page = report();
        assert!(page.contains("do not differ significantly at any point"), "{page}");
        for trend in ["rises", "falls", "furthest apart"] {
            assert!(!page.contains(trend), "{trend}: {page}");
        }
    }
    let map = "environment.delta_d = [0.1, 0.2]\n[[agent]]";
    let kind = "\"heat_map\"\nx = \"environment.sigma\"\ny = \"environment.delta_d\"\n\
                where = { scenario = \"P-H-D\" }";
    let manifest = manifest.replacen("[[agent]]", map, 1).replace("\"curve\"", kind);
    let folder = Folder::completed(&manifest);
    folder.jitai(["report", "sweep.toml", "--out", "report"]).succeeded();
    let page = folder.read("report/index.html");
    assert!(page.contains("Every tile has 5."), "{page}");
    assert!(!page.contains("the most at"), "{page}");
}

#[test]
fn tables_of_arms_give_the_share_of_the_optimum_where_it_is_known() {
    let manifest = "format = 1\nname = \"rules\"\nscenarios = [\"P-H-D\", \"L-H-D\", \"P-T\"]\nseeds = 3\n\
                    environment.sigma = [0.4, 0.6]\nenvironment.horizon = 8\n\
                    [[agent]]\nname = \"untailored\"\nalgorithm = \"rule\"\nrule = \"untailored\"\n\
                    [[agent]]\nname = \"tailored\"\nalgorithm = \"rule\"\nrule = \"tailored\"\n\
                    [[analysis]]\nname = \"returns\"\nkind = \"curve\"\n\
                    [[analysis]]\nname = \"learning\"\nkind = \"learning_curve\"\n";
    let folder = Folder::with(manifest);
    folder.jitai(["run", "sweep.toml"]).succeeded();
    folder.jitai(["report", "sweep.toml", "--out", "report"]).succeeded();
    let exact = folder.jitai(["optimum", "sweep.toml", "--format", "csv"]).succeeded().stdout;
    let best = |scenario: &str, sigma: &str| -> f64 {
        let cell = format!("rules,{scenario},{sigma},");
        let line = exact.lines().find(|line| line.starts_with(&cell));
        line.unwrap().split(',').nth(4).unwrap().parse().unwrap()
    };
    let table = folder.read("report/tables/rules-arms.csv");
    let names: Vec<&str> = table.lines().next().unwrap().split(',').collect();
    let column = |name: &str| names.iter().position(|known| *known == name).unwrap();
    let mut known = 0;
    for line in table.lines().skip(1) {
        let cells: Vec<&str> = line.split(',').collect();
        let number = |name: &str| cells[column(name)].parse::<f64>();
        let (arm, mean) = (cells[0], number("mean_return").unwrap());
        assert!(number("interquartile_mean").is_ok() && number("lower_quartile_return").is_ok());
        // Both rules send a message at every step, so the messages are at most the horizon.
        let messages = number("messages_per_episode").unwrap();
        assert!(messages > 1.0 && messages <= 8.0, "{messages}");
        if arm.contains("P-T") {
            assert!(number("optimum").is_err(), "{line}");
            continue;
        }
        let sigma = arm.rsplit('=').next().unwrap();
        let scenario = if arm.contains("P-H-D") { "P-H-D" } else { "L-H-D" };
        let exact = best(scenario, sigma);
        assert!((number("optimum").unwrap() - exact).abs() < 0.06, "{line}");
        let share = number("share_of_optimum").unwrap();
        assert!((share - mean / number("optimum").unwrap()).abs() < 1e-12 && share < 1.0, "{line}");
        known += 1;
    }
    assert_eq!(known, 8);
    let figure = folder.read("report/figures/rules-returns.svg");
    for label in [">optimum P-H-D</text>", ">optimum L-H-D</text>"] {
        assert!(figure.contains(label), "the reference lines have their labels");
    }
    let agents = folder.read("report/tables/rules-agents.csv");
    assert!(agents.lines().nth(1).unwrap().starts_with("untailored,P-H-D,2,6,"), "{agents}");
    // A rule learns nothing.
    assert_eq!(folder.read("report/tables/rules-learning.csv").lines().count(), 1);
}

/// Rules in two environments that differ in two zipped keys, and in one further key.
const ZIPPED: &str = r#"
format = 1
name = "zipped"
scenarios = ["P-T"]
seeds = 2
zip = [["environment.first_context", "environment.time_indicator"]]
[environment]
sigma = 0.6
horizon = 10
mu = [[0.1, 0.1], [0.0, 0.0]]
first_context = ["fixed", "sampled"]
time_indicator = ["lagged", "exact"]
[evaluation]
test_episodes = 20
[[agent]]
name = "chance"
algorithm = "rule"
rule = "random"
[[exclude]]
environment.mu = [[0.0, 0.0]]
environment.first_context = "sampled"
[[analysis]]
name = "first"
kind = "contrast"
by = "environment.first_context"
between = ["sampled", "fixed"]
"#;

#[test]
fn a_contrast_by_a_zipped_key_has_a_row_named_by_what_differs() {
    let folder = Folder::with(ZIPPED);
    folder.jitai(["run", "sweep.toml"]).succeeded();
    folder.jitai(["report", "sweep.toml", "--out", "r"]).succeeded();
    let table = folder.read("r/tables/zipped-first.csv");
    let mut rows = csv::Reader::from_reader(table.as_bytes());
    let rows: Vec<csv::StringRecord> = rows.records().map(Result::unwrap).collect();
    assert_eq!(rows.len(), 1, "{table}");
    assert_eq!(&rows[0][0], "chance P-T", "{table}");
}

#[test]
fn what_is_zipped_with_an_axis_changes_along_the_line_and_names_mention_one_of_zipped_keys() {
    let folder = Folder::with(&format!(
        "{}[[analysis]]\nname = \"spread\"\nkind = \"curve\"\nx = \"environment.delta_d\"\n",
        ZIPPED
            .replace(
                "first_context\", \"environment",
                "first_context\", \"environment.delta_d\", \"environment"
            )
            .replace("[evaluation]", "delta_d = [0.1, 0.2]\n[evaluation]")
    ));
    folder.jitai(["run", "sweep.toml"]).succeeded();
    folder.jitai(["report", "sweep.toml", "--out", "r"]).succeeded();
    let records = |name: &str| -> Vec<csv::StringRecord> {
        let table = folder.read(name);
        csv::Reader::from_reader(table.as_bytes()).records().map(Result::unwrap).collect()
    };
    // Two values of mu, one of which excludes a value of the zip: one line has two points, and the
    // other line has one point.
    let curve = records("r/tables/zipped-spread.csv");
    assert_eq!(curve.len(), 3, "{curve:?}");
    assert!(curve.iter().all(|row| !row.iter().any(|cell| cell.contains("time_indicator"))));
    // Data files name every key; texts for readers name one of the keys that change together.
    let names = |end: &str| folder.read(&format!("r/tables/zipped-arms.{end}"));
    assert!(names("csv").contains("time_indicator=exact"), "{}", names("csv"));
    let read = names("md");
    assert!(
        read.contains("first\\_context=sampled") || read.contains("first_context=sampled"),
        "{read}"
    );
    assert!(!read.contains("indicator") && !read.contains("δ"), "{read}");
}

#[test]
fn machines_are_named_only_if_asked_for() {
    let folder = Folder::completed(&manifest("sweep", "0.6", "1", Effort::Trivial));
    let store = Connection::open(folder.path("jitai.sqlite")).unwrap();
    let host: String = store.query_row("SELECT host FROM session", [], |row| row.get(0)).unwrap();
    let page = |arguments: &[&str]| {
        let arguments = ["report", "sweep.toml", "--out", "report"].iter().chain(arguments);
        folder.jitai(arguments.copied()).succeeded();
        folder.read("report/index.html")
    };
    let cell = format!(">{host}<");
    assert!(!page(&[]).contains(&cell));
    assert!(page(&["--hosts"]).contains(&cell));
}
