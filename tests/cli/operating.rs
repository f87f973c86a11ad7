//! Operating characteristics of estimates, with the truth of each trial.

use crate::support::Folder;

/// Nobody habituates or disengages, and the context has no effect on an untailored message: a message has 64 steps with
/// probability 1/3 of each kind, or 256 if it is tailored to the context.
const MANIFEST: &str = r#"format = 1
name = "sizes"
scenarios = ["C"]
seeds = 30

[environment]
horizon = 6
sigma = 0
epsilon_d = 0
epsilon_h = 0
initial_habituation = 0
rho_1 = 64
rho_2 = 64
mu = [0, 0]
step_noise = "gamma"
sigma_s = 150

[trial]
people = [5, 40]
days = 6

[evaluation]
on = "trial"

[[agent]]
name = "random"
algorithm = "rule"
rule = "random"

[[estimate]]
name = "first"
treatment = 1
truth = true

[[estimate]]
name = "any"
numerator = 0.75

[[analysis]]
name = "size"
kind = "operating_characteristics"
estimates = ["first"]
find = { power = 0.8 }

[[analysis]]
name = "any"
kind = "operating_characteristics"
estimates = ["any"]
"#;

/// The column of a CSV file, by row.
fn column(csv: &str, name: &str) -> Vec<String> {
    let mut reader = csv::Reader::from_reader(csv.as_bytes());
    let index = reader.headers().unwrap().iter().position(|one| one == name);
    let index = index.unwrap_or_else(|| panic!("no column {name} in {csv}"));
    reader.records().map(|row| row.unwrap()[index].to_owned()).collect()
}

fn numbers(csv: &str, name: &str) -> Vec<f64> {
    column(csv, name).iter().map(|text| text.parse().unwrap()).collect()
}

#[test]
fn characteristics_are_those_of_the_rows_of_estimates() {
    let folder = Folder::completed(MANIFEST);
    folder.jitai(["report", "sweep.toml", "--out", "report"]).succeeded();
    let csv = folder.read("report/tables/sizes-size.csv");
    assert_eq!(numbers(&csv, "x"), [5.0, 40.0]);
    assert_eq!(numbers(&csv, "trials"), [30.0, 30.0]);
    assert_eq!(
        folder.number("SELECT count(*) FROM estimate WHERE name = 'any' AND truth IS NULL"),
        60
    );
    for (index, people) in ["5", "40"].iter().enumerate() {
        let queried = |what: &str| -> f64 {
            let sql = format!(
                "SELECT {what} FROM estimate JOIN parameter USING (job_key)
                WHERE estimate.name = 'first' AND parameter.name = 'trial.people' AND value = {people}"
            );
            folder.store().query_row(&sql, [], |row| row.get(0)).unwrap()
        };
        // The effect of message 1 is 64 in every state.
        let truth = queried("avg(truth)");
        assert!((truth - 64.0).abs() < [40.0, 8.0][index], "{truth}");
        let held = format!("avg({truth:?} BETWEEN low AND high)");
        let exaggerated =
            format!("avg(CASE WHEN low > 0 OR high < 0 THEN abs(estimate) END) / {truth:?}");
        for (name, what) in [
            ("truth", "avg(truth)"),
            ("bias", "avg(estimate - truth)"),
            ("mean_error", "avg(standard_error)"),
            ("coverage", held.as_str()),
            ("power", "avg(low > 0 OR high < 0)"),
            ("mean_length", "avg(high - low)"),
        ] {
            let (found, expected) = (numbers(&csv, name)[index], queried(what));
            assert!((found - expected).abs() < 1e-9, "{name}: {found}, expected {expected}");
        }
        if *people == "40" {
            let wrong = "avg(CASE WHEN low > 0 OR high < 0 THEN estimate < 0 END)";
            let found = column(&csv, "type_s")[index].parse::<f64>().unwrap();
            assert_eq!((found, queried(wrong)), (0.0, 0.0));
            let times = column(&csv, "exaggeration")[index].parse::<f64>().unwrap();
            assert!((times - queried(&exaggerated)).abs() < 1e-9, "{times}");
        }
        let square = queried("avg((estimate - truth) * (estimate - truth))");
        assert!((numbers(&csv, "rmse")[index] - square.sqrt()).abs() < 1e-9, "{square}");
        let errors = [numbers(&csv, "bias_low")[index], numbers(&csv, "bias_high")[index]];
        assert!(errors[0] < 0.0 && errors[1] > 0.0, "an unbiased estimate: {errors:?}");
    }
    let powers = numbers(&csv, "power");
    assert!(powers[0] < 0.8 && powers[1] > 0.8, "{powers:?}");
    let page = folder.read("report/index.html");
    assert!(page.contains(" reaches a power of 80"));
    assert!(page.contains("the formula of Liao et al. (2016) gives"));
    folder.jitai(["report", "sweep.toml", "--set", "seeds=5", "--out", "few"]).succeeded();
    let few = folder.read("few/index.html");
    assert!(few.contains("has 5 trials per number of people, too few for a power of 80"));
    for what in ["power", "coverage", "bias"] {
        assert!(folder.read(&format!("report/figures/sizes-size-{what}.svg")).contains("<svg"));
    }
    let sql = folder.read("report/sql/sizes-size.sql");
    assert!(sql.contains("'trial.people') IN (5, 40)"), "{sql}");
    let rows = folder.jitai(["query", &sql, "--format", "csv"]).succeeded();
    assert_eq!(rows.stdout.lines().count() - 1, 120, "{sql}");
    // Without an axis there is a table alone, whose bias has a reason.
    let any = folder.read("report/tables/sizes-any.md");
    assert!(any.contains("has it simulated"), "{any}");
    assert!(!folder.path("report/figures/sizes-any.svg").exists());
}

/// Forty people, the effect of whose untailored message is swept.
fn effects() -> String {
    MANIFEST
        .replace("rho_1 = 64", "rho_1 = [20, 40, 80, 160]")
        .replace("people = [5, 40]", "people = 40")
        .replace("{ power = 0.8 }", "{ effect = \"environment.rho_1\", power = 0.8 }")
}

#[test]
fn the_smallest_effect_is_found_and_numbers_of_ones_own_are_shown() {
    let own = "diagnosands = { largest = \"max(estimate)\", found = \"avg(low > 0 OR high < 0)\", \
               none = \"avg(effective_sample_size)\", all = \"avg(failure IS NOT NULL)\" }\n";
    let manifest =
        effects().replace("estimates = [\"first\"]\n", &format!("estimates = [\"first\"]\n{own}"));
    let folder = Folder::completed(&manifest);
    folder.jitai(["report", "sweep.toml", "--out", "report"]).succeeded();
    let csv = folder.read("report/tables/sizes-size.csv");
    assert_eq!(numbers(&csv, "x"), [20.0, 40.0, 80.0, 160.0]);
    let page = folder.read("report/index.html");
    assert!(page.contains(" reaches a power of 80"), "{page}");
    assert!(page.contains(", a true effect of ") && page.contains("gives an effect of "));
    // Of the untailored message alone, the effect is its parameter.
    let (truth, x) = (numbers(&csv, "truth"), numbers(&csv, "x"));
    assert!(truth.iter().zip(&x).all(|(truth, x)| (truth / x - 1.0).abs() < 0.5), "{truth:?}");
    // The share that is found is the power, and its interval has the width of other intervals of shares.
    for (found, power) in numbers(&csv, "found").iter().zip(numbers(&csv, "power")) {
        assert!((found - power).abs() < 1e-12, "{found} {power}");
    }
    let [low, high] =
        ["found_low", "found_high"].map(|name| column(&csv, name)[1].parse::<f64>().unwrap());
    assert!(high - low > 0.2 && high - low < 0.6, "{low} {high}");
    let largest: f64 = folder
        .store()
        .query_row(
            "SELECT max(estimate) FROM estimate JOIN parameter USING (job_key)
            WHERE estimate.name = 'first' AND parameter.name = 'environment.rho_1' AND value = 160",
            [],
            |row| row.get(0),
        )
        .unwrap();
    assert_eq!(numbers(&csv, "largest")[3], largest);
    assert_eq!(column(&csv, "none"), ["", "", "", ""]);
    let table = folder.read("report/tables/sizes-size.md");
    assert!(table.contains("it is no number"));
    // Groups of trials say nothing about an extreme, nor about a share that no trial changes.
    for (own, why) in
        [("largest", "a maximum or minimum over trials"), ("all", "no Monte Carlo error")]
    {
        assert!(column(&csv, &format!("{own}_low")).iter().all(String::is_empty), "{csv}");
        assert!(table.contains(why), "{table}");
    }
    assert_eq!(numbers(&csv, "all"), [0.0; 4]);
}

#[test]
fn a_power_that_falls_before_it_rises_is_said_at_both_ends() {
    let folder = Folder::with(
        "format = 1\nname = \"sizes\"\nscenarios = \"all\"\nseeds = 20\n\
         environment = { family = \"declared\", model = \"m.toml\", parameters.effect = [0, 0.5, 1.5] }\n\
         trial = { people = 10, days = 40 }\nevaluation.on = \"trial\"\n\
         [[agent]]\nname = \"random\"\nalgorithm = \"rule\"\nrule = \"random\"\n\
         [[estimate]]\nname = \"mean\"\ntruth = true\n\
         [[analysis]]\nname = \"size\"\nkind = \"operating_characteristics\"\n\
         find = { effect = \"environment.parameters.effect\", power = 0.8 }\n",
    );
    folder.write(
        "m.toml",
        "format = 1\ndays = 40\n[parameters]\neffect = 0\n[variables]\n\
         x = { gaussian = [0, 1] }\ny = { gaussian = [\"action * (effect - 0.5)\", 1] }\n\
         [roles]\noutcome = \"y\"\nfeatures = [{ name = \"x\", low = -4, high = 4 }]\n",
    );
    folder.jitai(["run", "sweep.toml"]).succeeded();
    folder.jitai(["report", "sweep.toml", "--out", "report"]).succeeded();
    let page = folder.read("report/index.html");
    for says in [
        " reaches a power of 80",
        "; with effect = 0 the power is 100.0",
        " already, where the true effect has the other sign",
    ] {
        assert!(page.contains(says), "{page}");
    }
}

#[test]
fn the_formula_is_of_least_squares_alone() {
    let manifest = |estimator: &str| {
        format!(
            "format = 1\nname = \"sizes\"\nscenarios = \"all\"\nseeds = 20\n\
             environment = {{ family = \"declared\", model = \"binary_outcome.toml\" }}\n\
             trial = {{ people = [10, 60], days = 30 }}\nevaluation.on = \"trial\"\n\
             [[agent]]\nname = \"random\"\nalgorithm = \"rule\"\nrule = \"random\"\n\
             [[estimate]]\nname = \"mean\"\nestimator = \"{estimator}\"\n\
             [[analysis]]\nname = \"size\"\nkind = \"operating_characteristics\"\nfind = {{ power = 0.8 }}\n"
        )
    };
    let model = std::fs::read_to_string("experiments/models/binary_outcome.toml").unwrap();
    for (estimator, has_formula) in [("wcls", true), ("emee", false)] {
        let folder = Folder::with(&manifest(estimator));
        folder.write("binary_outcome.toml", &model);
        folder.jitai(["run", "sweep.toml"]).succeeded();
        folder.jitai(["report", "sweep.toml", "--out", "report"]).succeeded();
        let page = folder.read("report/index.html");
        assert!(page.contains("a power of 80"), "{page}");
        assert_eq!(page.contains("the formula of Liao"), has_formula, "{estimator}");
    }
}

#[test]
fn a_diagnosand_that_is_no_aggregate_is_refused_before_the_report() {
    for (expression, says) in [
        ("avg(estimat)", "`diagnosands`: `own`: no such column: estimat"),
        ("estimate", "`own`: it has a value for each trial"),
        ("avg(low); DROP TABLE estimate", "`own`: near"),
        ("avg(low)), (avg(high)", "`own`: expected a single expression"),
    ] {
        let own = format!("diagnosands = {{ own = \"{expression}\" }}\n");
        let folder = Folder::with(&effects().replace("find = ", &format!("{own}find = ")));
        folder.jitai(["check", "sweep.toml"]).ended(2).says(says);
        folder.jitai(["check", "sweep.toml"]).ended(2).says("write an aggregate over the rows");
        folder.jitai(["run", "sweep.toml", "--set", "seeds=1"]).succeeded();
        folder.jitai(["report", "sweep.toml", "--out", "report"]).ended(2).says(says);
        assert!(!folder.path("report/index.html").exists());
    }
    let taken = effects().replace("find = ", "diagnosands = { bias = \"avg(estimate)\" }\nfind = ");
    let folder = Folder::with(&taken);
    folder.jitai(["check", "sweep.toml"]).ended(2).says("the table has a column of this name");
}

#[test]
fn what_cannot_be_shown_is_refused() {
    let refused = |text: String, says: &str| {
        let folder = Folder::with(&text);
        folder.jitai(["check", "sweep.toml"]).ended(2).says(says);
    };
    refused(MANIFEST.replace("[\"first\"]", "[\"second\"]"), "no [[estimate]] is called `second`");
    refused(
        MANIFEST.replace("power = 0.8", "power = 1.5"),
        "`find`: expected { power = 0.8 } or another number between 0 and 1",
    );
    refused(
        effects().replace("environment.rho_1\"", "environment.rho_9\""),
        "`find`: expected the dotted name of a parameter",
    );
    refused(effects().replace("[20, 40, 80, 160]", "20"), "`environment.rho_1` is not swept");
    refused(
        effects().replace("find = ", "x = \"trial.people\"\nfind = "),
        "`find` is sought along `environment.rho_1`, and `x` is `trial.people`",
    );
    refused(
        effects().replace("find = ", "diagnosands = [\"avg(estimate)\"]\nfind = "),
        "`diagnosands`: expected names of lower-case letters, each with an expression of SQL",
    );
    let (without, _) = MANIFEST.split_once("[[estimate]]").unwrap();
    let analysis = "[[analysis]]\nname = \"size\"\nkind = \"operating_characteristics\"\n";
    refused(format!("{without}{analysis}"), "needs an [[estimate]]");
    refused(MANIFEST.replace("people = [5, 40]", "people = 5"), "`trial.people` is not swept");
    let none = MANIFEST
        .replace("[trial]\npeople = [5, 40]\ndays = 6\n", "")
        .replace("on = \"trial\"\n", "");
    let none = none.replace("find = { power = 0.8 }\n", "");
    refused(none, "`truth`: it is simulated for the people of a [trial] alone");
}
