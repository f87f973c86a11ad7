//! Manifests from the outside: the messages about faulty manifests, the jobs that the shipped manifests
//! declare, and what the reference and the schema state about both.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::sync::mpsc;
use std::time::Duration;
use std::{fs, panic, thread};

use jitai::job::{PlannedJob, Versions};
use jitai::key::{SectionName, Value};
use jitai::manifest::{self, Manifest, Section};
use jitai::plan::{self};

/// Compares `actual` with the file at `expected`; the error says how to accept `actual` instead.
fn assert_text(actual: &str, expected: &Path) -> Result<(), String> {
    if fs::read_to_string(expected).is_ok_and(|text| text == actual) {
        return Ok(());
    }
    let name = expected.file_name().unwrap();
    let kept = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    fs::write(&kept, actual).unwrap();
    let accept = format!("cp '{}' '{}'", kept.display(), expected.display());
    Err(format!(
        "{actual}\nis not what stands in {}; to accept it:\n{accept}\n",
        expected.display()
    ))
}

fn bad_manifests() -> Vec<PathBuf> {
    let entries = fs::read_dir("tests/data/manifests").unwrap().map(|entry| entry.unwrap().path());
    let mut stems: Vec<PathBuf> = entries.map(|path| path.with_extension("")).collect();
    stems.sort();
    stems.dedup();
    stems
}

#[test]
fn every_faulty_manifest_gets_its_exact_messages() {
    let mut failures = String::new();
    for stem in bad_manifests() {
        let path = stem.with_extension("toml");
        let report = match manifest::load(&path) {
            Ok(_) => panic!("{} has no fault", path.display()),
            Err(faults) => format!("{faults}\n"),
        };
        if let Err(failure) = assert_text(&report, &stem.with_extension("txt")) {
            failures.push_str(&failure);
        }
    }
    assert!(failures.is_empty(), "{failures}");
    assert!(bad_manifests().len() >= 30);
}

#[test]
fn a_faulty_manifest_has_one_fault_unless_it_is_named_for_many() {
    for stem in bad_manifests() {
        let faults = manifest::load(&stem.with_extension("toml")).unwrap_err();
        let name = stem.file_name().unwrap().to_string_lossy();
        let many = name.starts_with("bad-many-");
        assert_eq!(faults.list().len() > 1, many, "{}\n{faults}", stem.display());
    }
}

#[test]
fn faults_are_data_for_programs() {
    let faults = manifest::load(Path::new("tests/data/manifests/bad-unknown-key.toml"));
    let json = serde_json::to_value(faults.unwrap_err()).unwrap();
    assert_eq!(json[0]["line"], 7);
    assert_eq!(json[0]["column"], 1);
    assert_eq!(json[0]["help"], "did you mean `sigma`?");
}

#[test]
fn what_is_no_file_of_text_is_refused_without_waiting() {
    let folder = tempfile::tempdir().unwrap();
    let large = folder.path().join("large.toml");
    fs::write(&large, vec![b'#'; 10_000_001]).unwrap();
    let report = manifest::load(&large).unwrap_err().to_string();
    assert!(report.contains("the file is larger than 10000000 bytes"), "{report}");
    #[cfg(unix)]
    {
        let report = manifest::load(Path::new("/dev/zero")).unwrap_err().to_string();
        assert!(report.contains("/dev/zero: is not a regular file"), "{report}");
    }
}

fn shipped() -> Vec<(&'static str, u64)> {
    vec![
        ("experiments/quickstart.toml", 24),
        ("experiments/heat_maps.toml", 384),
        ("experiments/readings.toml", 690),
        ("experiments/reference.toml", 324),
        ("experiments/trial.toml", 6),
        ("experiments/trial_design.toml", 320),
        ("experiments/trial_power.toml", 3200),
        ("experiments/value.toml", 800),
        ("experiments/relative_risk.toml", 1200),
        ("experiments/least_effect.toml", 4000),
        ("experiments/at_horizon.toml", 60),
        ("experiments/bandits.toml", 920),
        ("experiments/models/trial.toml", 60),
        ("experiments/models/noisy_dose_trial.toml", 10),
        ("experiments/heartsteps/effects.toml", 1),
        ("experiments/heartsteps/next_trial.toml", 540),
        ("experiments/heartsteps/uncertain.toml", 3300),
        ("experiments/external/outside.toml", 21),
        ("experiments/external/cartpole.toml", 12),
        ("experiments/external/trial.toml", 9),
        ("experiments/external/two_messages.toml", 48),
        ("experiments/memory.toml", 1080),
        ("experiments/belief.toml", 1360),
        ("experiments/unavailable.toml", 160),
        ("experiments/bots/figure_1.toml", 140),
        ("experiments/bots/figure_5.toml", 140),
        ("experiments/bots/figure_5_readings.toml", 170),
        ("experiments/step_count.toml", 180),
        ("experiments/population.toml", 40),
        ("experiments/oralytics/updates.toml", 100),
        ("experiments/pooling.toml", 7500),
        ("experiments/shrinkage.toml", 60),
        ("experiments/rome/rectangular.toml", 300),
        ("experiments/rome/triangular.toml", 300),
        ("experiments/oralytics/rewards_v1.toml", 80),
        ("experiments/paper/context_error.toml", 144),
        ("experiments/paper/disengagement.toml", 192),
        ("experiments/paper/learning_curves.toml", 18),
        // All that the races may come to: 2 agents × 64 arms × 19 seeds, and 2 agents with 10 fresh seeds.
        ("experiments/paper/search.toml", 2452),
        ("experiments/paper/ten_seeds.toml", 480),
    ]
}

/// Manifests that need files of people, which are not shipped.
const WITH_PEOPLE: [(&str, u64); 5] = [
    ("experiments/oralytics/heat_maps_v1.toml", 30_000),
    ("experiments/oralytics/heat_maps_v2.toml", 120_000),
    ("experiments/oralytics/heat_maps_v3.toml", 60_000),
    ("experiments/oralytics/pooling.toml", 3000),
    ("experiments/oralytics/learned.toml", 8500),
];

#[test]
fn manifests_with_people_hold_with_invented_ones_and_ask_for_the_files() {
    let folder = tempfile::tempdir().unwrap();
    let put = |name: &str, text: &str| fs::write(folder.path().join(name), text).unwrap();
    let source = Path::new("experiments/oralytics");
    let read = |name: &str| fs::read_to_string(source.join(name)).unwrap();
    ["v1.toml", "v2.toml", "v4.toml"].into_iter().for_each(|model| put(model, &read(model)));
    for (path, _) in WITH_PEOPLE {
        let name = Path::new(path).file_name().unwrap().to_str().unwrap();
        put(name, &read(name));
        let faults = manifest::load(&folder.path().join(name)).unwrap_err().to_string();
        let asks_for = ["experiments/oralytics/people.py", "people_v1.py", "v1.csv"];
        assert!(asks_for.iter().any(|file| faults.contains(file)), "{faults}");
    }
    for (name, like) in [
        ("v1.csv", "synthetic_v1.csv"),
        ("v2.csv", "synthetic_v2.csv"),
        ("v2_daily.csv", "synthetic_v2_daily.csv"),
        ("v3.csv", "synthetic_v3.csv"),
        ("v3_daily.csv", "synthetic_v4.csv"),
        ("v4.csv", "synthetic_v4.csv"),
    ] {
        put(name, &read(like));
    }
    put("v1_published.csv", "value,n\n1,100\n");
    for (name, people) in
        [("v1_trials.csv", 72), ("v2_trials.csv", 70), ("v3_trials.csv", 70), ("v4_trial.csv", 72)]
    {
        let rows: String = (0..people).map(|person| format!("{person},0\n")).collect();
        put(name, &format!("person,row\n{rows}"));
    }
    let stays: String = (0..72).map(|day| format!("{day},{}\n", day + 70)).collect();
    put("stays.csv", &format!("start_day,end_day\n{stays}"));
    let own_stays = "entry = \"stays.csv\"";
    put("pooling.toml", &read("pooling.toml").replace("entry = \"v4.csv\"", own_stays));
    put("learned.toml", &read("learned.toml").replace("entry = \"v4.csv\"", own_stays));
    for name in ["published_v2.csv", "published_v3.csv", "published_v4.csv"] {
        put(name, &read(name));
    }
    for (path, jobs) in WITH_PEOPLE {
        let name = Path::new(path).file_name().unwrap();
        let manifest = manifest::load(&folder.path().join(name)).unwrap();
        assert_eq!(plan::count(&manifest), jobs, "{path}");
        assert!(manifest.source.contains(&format!("{jobs} jobs")), "{path}");
    }
}

#[test]
fn every_shipped_manifest_is_valid_and_says_how_many_jobs_it_has() {
    for (path, jobs) in shipped() {
        let manifest = manifest::load(Path::new(path)).unwrap();
        assert_eq!(plan::count(&manifest), jobs, "{path}");
        assert_eq!(plan::jobs(&manifest).count() as u64, jobs, "{path}");
        let said = manifest.source.lines().any(|line| line.contains(&format!("{jobs} job")));
        assert!(said, "{path} does not say that it has {jobs} jobs");
    }
}

#[test]
fn every_manifest_of_experiments_is_tested_and_names_the_schema() {
    let folders = ["", "/bots", "/external", "/oralytics", "/paper"];
    for folder in folders.map(|below| format!("experiments{below}")) {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            // Published numbers, models and queries are not manifests.
            let is_toml = path.extension().is_some_and(|extension| extension == "toml");
            let others = [
                "bots/published.toml",
                "oralytics/v1.toml",
                "oralytics/v2.toml",
                "oralytics/v4.toml",
            ];
            if !is_toml || others.iter().any(|other| path.ends_with(other)) {
                continue;
            }
            let mut all = shipped().into_iter().chain(WITH_PEOPLE);
            let tested = all.any(|(known, _)| Path::new(known) == path);
            assert!(tested, "{}", path.display());
            let text = fs::read_to_string(&path).unwrap();
            let schema = text.lines().next().and_then(|line| line.strip_prefix("#:schema "));
            assert!(path.parent().unwrap().join(schema.unwrap()).is_file(), "{}", path.display());
        }
    }
}

#[test]
fn the_readings_differ_from_the_published_settings_in_one_thing_each() {
    let manifest = manifest::load(Path::new("experiments/readings.toml")).unwrap();
    let mut published = 0;
    for PlannedJob { agent, job, .. } in plan::jobs(&manifest) {
        let of_the_text = agent.ends_with("-text");
        let task = job.task();
        let environment = &task.model().parameters;
        let from_the_text = environment.first_context == jitai::env::FirstContext::Sampled;
        let readings = [
            from_the_text && !of_the_text,
            environment.time_one_hot,
            environment.observed_probability == 1,
            environment.initial_habituation == 0.0,
            job.evaluation.test_actions == jitai::job::TestActions::Greedy,
            !["dqn", "reinforce"].contains(&&*agent),
        ];
        let differences = readings.iter().filter(|reading| **reading).count();
        assert!(differences <= 1, "{agent}: {readings:?}");
        assert!(from_the_text || !of_the_text, "{agent} has the environment of the text");
        published += usize::from(differences == 0);
    }
    // Three scenarios at one sigma, and one of these scenarios at two more sigmas.
    assert_eq!(published, 2 * (3 + 2) * 10, "two agents, ten seeds");
}

#[test]
fn the_resolved_form_of_every_shipped_manifest_declares_the_same_jobs() {
    for (path, _) in shipped() {
        let written = manifest::load(Path::new(path)).unwrap();
        let resolved = manifest::parse("resolved", written.resolved().as_bytes()).unwrap();
        assert_eq!(resolved.resolved(), written.resolved(), "{path}");
        assert!(plan::jobs(&written).eq(plan::jobs(&resolved)), "{path}");
    }
}

#[test]
fn the_schema_in_the_documentation_is_the_programs_own() {
    let schema = format!("{}\n", serde_json::to_string_pretty(&manifest::schema()).unwrap());
    let renew = "or run: jitai schema > docs/manifest.schema.json";
    let same = assert_text(&schema, Path::new("docs/manifest.schema.json"));
    assert!(same.is_ok(), "{}{renew}", same.unwrap_err().split("to accept it:").last().unwrap());
}

fn key_table(section: Section) -> String {
    let mut table = "| key | values | default | meaning |\n| --- | --- | --- | --- |\n".to_owned();
    for key in section.keys() {
        let default = key.default().map_or("required".to_owned(), |value| format!("`{value}`"));
        let (name, values, doc) = (key.name, key.kind.expectation(), key.doc());
        writeln!(table, "| `{name}` | {values} | {default} | {doc} |").unwrap();
    }
    table
}

/// The pages that have the tables of keys.
const REFERENCE: [&str; 4] =
    ["docs/manifest.md", "docs/models.md", "docs/recorded.md", "docs/trials.md"];

#[test]
fn the_reference_lists_every_key_with_its_values_and_default() {
    let mut pages: Vec<(&Path, String)> = REFERENCE
        .map(|page| (Path::new(page), fs::read_to_string(page).unwrap()))
        .into_iter()
        .collect();
    for section in Section::all() {
        let name = section.title();
        let (open, close) = (format!("<!-- keys of {name} -->\n"), "<!-- end of keys -->");
        let mut having = pages.iter_mut().filter(|(_, text)| text.contains(&open));
        let (_, text) = having.next().unwrap_or_else(|| panic!("no {open}"));
        assert!(having.next().is_none(), "{open} stands on two pages");
        let start = text.find(&open).unwrap() + open.len();
        let end = start + text[start..].find(close).unwrap();
        text.replace_range(start..end, &key_table(section));
    }
    for (path, actual) in pages {
        let same = assert_text(&actual, path);
        assert!(same.is_ok(), "{}", same.unwrap_err().split("to accept it:").last().unwrap());
    }
}

#[test]
fn the_manifests_of_the_reference_are_valid() {
    let reference = fs::read_to_string("docs/manifest.md").unwrap();
    let blocks = reference.split("```toml\n").skip(1).map(|rest| rest.split("```").next().unwrap());
    let whole: Vec<_> = blocks.filter(|block| block.contains("format = 1")).collect();
    assert!(!whole.is_empty());
    for block in whole {
        manifest::parse("docs/manifest.md", block.as_bytes()).unwrap();
    }
}

/// A linear congruential generator (Knuth's MMIX constants): the same numbers every time.
struct Draws(u64);

impl Draws {
    fn below(&mut self, limit: usize) -> usize {
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as usize % limit
    }
}

fn mutate(bytes: &mut Vec<u8>, draws: &mut Draws) {
    const SPICE: &[&[u8]] = &[
        b"[",
        b"]",
        b"{",
        b"}",
        b"\"",
        b"=",
        b"\n",
        b".",
        b"-",
        b"e9",
        b"nan",
        b"inf",
        b"\xff",
        b"\0",
        b"[[",
        b"0x",
        b"99999999",
        b"'''",
        b"agent",
        b"zip",
        b"\xe2\x80\xae",
    ];
    for _ in 0..=draws.below(4) {
        let at = draws.below(bytes.len());
        let end = (at + draws.below(12)).min(bytes.len());
        match draws.below(4) {
            0 => bytes[at] = draws.below(256) as u8,
            1 => drop(bytes.splice(at..end, []).collect::<Vec<_>>()),
            2 => drop(bytes.splice(at..at, SPICE[draws.below(SPICE.len())].iter().copied())),
            _ => {
                let copy = bytes[at..end].to_vec();
                let to = draws.below(bytes.len());
                drop(bytes.splice(to..to, copy));
            }
        }
    }
}

#[test]
fn no_mutation_of_a_manifest_makes_the_reader_panic() {
    let mut draws = Draws(20_260_101);
    let originals: Vec<Vec<u8>> =
        shipped().iter().map(|(path, _)| fs::read(path).unwrap()).collect();
    let mut valid = 0;
    for round in 0..4000 {
        let mut bytes = originals[round % originals.len()].clone();
        mutate(&mut bytes, &mut draws);
        let outcome = panic::catch_unwind(|| match manifest::parse("mutated", &bytes) {
            Ok(manifest) => plan::count(&manifest) > 0,
            Err(faults) => faults.to_string().is_empty(),
        });
        let text = String::from_utf8_lossy(&bytes);
        assert!(outcome.is_ok(), "panic in round {round} on:\n{text}");
        valid += usize::from(outcome.unwrap());
    }
    assert!(valid > 100, "only {valid} mutations were valid: the mutations are too coarse");
}

/// The result of `work`; fails if the work takes unreasonably long.
#[track_caller]
fn within_patience<T: Send + 'static>(what: &str, work: impl FnOnce() -> T + Send + 'static) -> T {
    const PATIENCE: Duration = Duration::from_secs(60);
    let (tell, told) = mpsc::channel();
    thread::spawn(move || tell.send(work()));
    told.recv_timeout(PATIENCE).unwrap_or_else(|error| panic!("{what}: {error}"))
}

#[test]
fn deep_or_repetitive_texts_are_refused_and_do_not_hang() {
    let hostile = [
        "[".repeat(300_000),
        format!("a = {}", "[".repeat(300_000)),
        format!("a = {}", "{a = ".repeat(30_000)),
        format!("{}= 1", "a.".repeat(30_000)),
        "a = 1\n".repeat(30_000),
        (0..30_000).fold(String::new(), |text, i| text + &format!("a{i} = 1\n")),
        "[[agent]]\n".repeat(30_000),
        "\"".repeat(300_000),
        format!("format = 1\nscenarios = [{}]", "\"P-T\",".repeat(60_000)),
    ];
    for text in hostile {
        let shown = text.get(..20).unwrap_or(&text).to_owned();
        let report = within_patience(&shown, move || {
            manifest::parse("hostile", text.as_bytes()).unwrap_err().to_string()
        });
        assert!(report.len() < 1_000_000, "{shown}: {} bytes", report.len());
    }
}

/// Analyses that demand much work.
const CURVE: &str = "name = NAME\nkind = \"curve\"";

/// A small manifest that demands much work from its agents and from the tables in `rest`.
fn small_bomb(top: &str, environment: &str, agents: usize, rest: &str) -> String {
    let agents: String = (0..agents)
        .map(|i| format!("[[agent]]\nname = \"{i}\"\nalgorithm = \"reinforce\"\n"))
        .collect();
    format!(
        "format = 1\nname = \"bomb\"\nscenarios = [\"P-T\"]\n{top}\n[environment]\n{environment}\n\
         {agents}{rest}"
    )
}

#[test]
fn small_manifests_that_ask_for_too_much_are_refused_before_it_is_done() {
    let million = "{ from = 0.000001, to = 1.0, step = 0.000001 }";
    let each = |table: &str, keys: &str| {
        let entry = |i| format!("[[{table}]]\n{}\n", keys.replace("NAME", &format!("\"{i}\"")));
        (0..1000).map(entry).collect::<String>()
    };
    let sigma_in = |values: &str| format!("environment.sigma = {values}");
    let names: Vec<String> = Section::all()[..2]
        .iter()
        .flat_map(|section| section.keys().iter().map(move |key| (section.name(), key.name)))
        .map(|(section, key)| format!("\"{section}.{key}\""))
        .collect();
    let zips = vec![format!("[{}]", names.join(", ")); 1000].join(", ");
    let (values, jobs) = ("have at most 2000000 values in all", "jobs; the maximum is 10000000");
    let comparisons = |of: &str| format!("the {of} need ");
    let bombs = [
        // Values of ranges: in the grid, in exclusions, and in analyses.
        (
            values.to_owned(),
            small_bomb(
                "seeds = 1",
                &["sigma", "delta_h", "epsilon_h", "delta_d", "epsilon_d"]
                    .map(|key| format!("{key} = {million}"))
                    .join("\n"),
                1,
                "",
            ),
        ),
        (
            values.to_owned(),
            small_bomb("seeds = 1", "sigma = 1", 1, &each("exclude", &sigma_in(million))),
        ),
        (
            values.to_owned(),
            small_bomb(
                "seeds = 1",
                "sigma = 1",
                1,
                &each("analysis", &format!("{CURVE}\nwhere.{}", sigma_in(million))),
            ),
        ),
        // Jobs: of one agent, and of many agents.
        (jobs.to_owned(), small_bomb("seeds = 10_000_000", &format!("sigma = {million}"), 1, "")),
        (
            jobs.to_owned(),
            small_bomb("seeds = 1000", "sigma = { from = 0, to = 1, count = 101 }", 1000, ""),
        ),
        // Comparisons: cells with exclusions, places of an axis with exclusions, agents with the values
        // in conditions, and analyses with the values of the grid.
        (
            comparisons("exclusions"),
            small_bomb(
                "seeds = 10_000",
                "sigma = { from = 0, to = 9, count = 1000 }",
                1,
                &each("exclude", "seed = 1\nenvironment.sigma = 0"),
            ),
        ),
        (
            comparisons("exclusions"),
            small_bomb(
                "seeds = 1",
                &format!("sigma = {million}"),
                10,
                &each("exclude", &sigma_in("0.5")),
            ),
        ),
        (
            comparisons("exclusions"),
            small_bomb(
                "seeds = 1",
                "sigma = 1",
                1000,
                &format!(
                    "[[exclude]]\n{}\n[[exclude]]\nenvironment.delta_h = {million}\n",
                    sigma_in(million)
                ),
            ),
        ),
        (
            comparisons("analyses"),
            small_bomb(
                "seeds = 1",
                &format!("sigma = {million}"),
                1,
                &each("analysis", &format!("{CURVE}\nwhere.{}", sigma_in("0.5"))),
            ),
        ),
        (
            "is already in another zip".to_owned(),
            small_bomb(&format!("seeds = 1\nzip = [{zips}]"), "sigma = 1", 1, ""),
        ),
    ];
    // Each limit is checked before the work that would exceed it begins.
    for (number, (reason, text)) in bombs.iter().enumerate() {
        assert!(text.len() < 2_000_000);
        let report = manifest::parse("bomb", text.as_bytes()).unwrap_err().to_string();
        let head: String = report.chars().take(300).collect();
        assert!(report.contains(reason), "{number}: {head}");
        assert!(report.len() < 1_000_000, "{number}: {} bytes", report.len());
    }
}

fn jobs_of(text: &str) -> Vec<PlannedJob> {
    plan::expand(&parsed(text))
}

fn parsed(text: &str) -> Manifest {
    manifest::parse("test", text.as_bytes()).unwrap()
}

/// Asserts the canonical form and the key of a manifest's first job, under the first versions of the
/// code.
fn assert_first_job(text: &str, canonical: &str, key: &str) {
    let job = &jobs_of(text)[0].job;
    assert_eq!(job.canonical(), canonical);
    let first = Versions { environment: 1, algorithm: 1 };
    assert_eq!(job.form().key_under(first).to_string(), key);
    assert_eq!(job.key(), job.versions().key_of(canonical));
}

#[test]
fn job_keys_are_what_every_store_holds() {
    let head = "format = 1\nname = \"pinned\"\nextends = \"paper\"\nscenarios = [\"P-H-D\"]\n";
    assert_first_job(
        &format!("{head}[environment]\nsigma = 0.4"),
        r#"{"agent":{"activation":"relu","algorithm":"dueling_dqn","batch":64,"buffer":1000000,"engine":"fused","episodes":1000,"epsilon_decrement":0.001,"epsilon_floor":0.01,"epsilon_start":1.0,"gamma":0.99,"layers":[128,128],"learning_rate":0.0005,"target_period":1000,"terminal_target":"zero","trunk":"shared"},"environment":{"delta_d":0.1,"delta_h":0.1,"disengagement_threshold":1.0,"epsilon_d":0.4,"epsilon_h":0.05,"first_context":"fixed","horizon":50,"initial_disengagement":0.1,"initial_habituation":0.1,"mu":[0.1,0.1],"observed_probability":0,"rho_1":50.0,"rho_2":200.0,"sigma":0.4,"time_indicator":"lagged","time_indicator_period":2,"time_one_hot":false},"evaluation":{"curve_stride":10,"test_actions":"as_trained","test_episodes":1000},"scenario":"P-H-D","seed":1}"#,
        "8e49104e121b2c9f8d6d061df80df29d",
    );
    let reinforce = "[[exclude]]\nagent.name = \"dqn\"\n[environment]\nsigma = 0.4";
    assert_first_job(
        &format!("{head}{reinforce}"),
        r#"{"agent":{"activation":"relu","algorithm":"reinforce","engine":"fused","episodes":15000,"gamma":0.99,"layers":[128],"learning_rate":0.0006,"loss_divisor":50.0,"trajectories_per_update":1},"environment":{"delta_d":0.1,"delta_h":0.1,"disengagement_threshold":1.0,"epsilon_d":0.4,"epsilon_h":0.05,"first_context":"fixed","horizon":50,"initial_disengagement":0.1,"initial_habituation":0.1,"mu":[0.1,0.1],"observed_probability":0,"rho_1":50.0,"rho_2":200.0,"sigma":0.4,"time_indicator":"lagged","time_indicator_period":2,"time_one_hot":false},"evaluation":{"curve_stride":10,"test_actions":"as_trained","test_episodes":1000},"scenario":"P-H-D","seed":1}"#,
        "c1e9d5b844eeee828213b879e7f95190",
    );
    assert_first_job(
        "format = 1\nname = \"odd\"\nscenarios = [\"T-C\"]\nseeds = [9223372036854775807]\n\
         [environment]\nsigma = 1e6\nmu = [-0.0, 1e-300]\ndelta_d = 0.30000000000000004\n\
         rho_1 = -50\ntime_one_hot = true\nobserved_probability = 1\n\
         [[agent]]\nname = \"a\"\nalgorithm = \"reinforce\"\nlayers = [1, 4096, 3]\n\
         learning_rate = 1e-7\nactivation = \"tanh\"\n[evaluation]\ntest_actions = \"greedy\"",
        r#"{"agent":{"activation":"tanh","algorithm":"reinforce","engine":"fused","episodes":15000,"gamma":0.99,"layers":[1,4096,3],"learning_rate":1e-7,"loss_divisor":50.0,"trajectories_per_update":1},"environment":{"delta_d":0.30000000000000004,"delta_h":0.1,"disengagement_threshold":1.0,"epsilon_d":0.4,"epsilon_h":0.05,"first_context":"fixed","horizon":50,"initial_disengagement":0.1,"initial_habituation":0.1,"mu":[0.0,1e-300],"observed_probability":1,"rho_1":-50.0,"rho_2":200.0,"sigma":1000000.0,"time_indicator":"lagged","time_indicator_period":2,"time_one_hot":true},"evaluation":{"curve_stride":10,"test_actions":"greedy","test_episodes":1000},"scenario":"T-C","seed":9223372036854775807}"#,
        "a1516ede82697670563b6082211045ce",
    );
}

#[test]
fn integers_stand_for_numbers_without_making_other_jobs() {
    let text = |rho: &str| {
        format!(
            "format = 1\nname = \"n\"\nextends = \"paper\"\nscenarios = [\"P-T\"]\n\
             [environment]\nsigma = 0\nrho_1 = {rho}"
        )
    };
    assert_eq!(jobs_of(&text("50")), jobs_of(&text("50.0")));
    assert_eq!(
        parsed(&text("50")).sections[SectionName::Environment].get("rho_1"),
        Some(&[Value::Real(50.0)][..])
    );
}
