//! `jitai fit`: the files that it writes, faults of models and data, and stops.

use std::fmt::Write;
use std::time::{Duration, Instant};

use crate::support::{Folder, assert_prompt};

const MODEL: &str = r#"format = 1
title = "Walks"
unit = "minutes"
decisions_per_day = 2
days = 20
[linear]
base = { prefix = "b_", features = ["dose", "slot_now", "1"] }
gain = { prefix = "g_", features = ["1"] }
[variables]
slot_now = "slot"
dose     = "0.8 * default(dose[-1], 0) + default(action[-1], 0)"
minutes  = { gaussian = ["base + action * gain", "sigma"] }
[roles]
outcome  = "minutes"
features = [{ name = "dose", low = 0, high = 5 }]
[fit]
person      = "id"
order       = ["day", "part"]
action      = "sent"
probability = "p"
available   = "free"
columns     = { minutes = "walked" }
"#;

const HEADER: &str = "id,day,part,sent,p,free,walked\n";

/// Two people with 12 decisions each.
fn data() -> String {
    data_of(&[("ann", 20), ("bob", 30)])
}

/// People with these levels and 12 decisions each.
fn data_of(people: &[(&str, i32)]) -> String {
    let mut text = HEADER.to_owned();
    for (person, level) in people {
        for decision in 0..12 {
            let (day, part) = (decision / 2 + 1, decision % 2);
            let sent = decision * 7 % 3 % 2;
            let walked = level + 5 * sent + decision * decision % 5;
            writeln!(text, "{person},{day},{part},{sent},0.4,1,{walked}").unwrap();
        }
    }
    text
}

fn folder(model: &str, data: &str) -> Folder {
    let folder = Folder::new();
    folder.write("world.toml", model);
    folder.write("pilot.csv", data);
    folder
}

const FIT: [&str; 6] = ["fit", "world.toml", "--data", "pilot.csv", "--out", "fitted"];

#[test]
fn the_people_of_a_fit_run_at_once_and_the_same_input_gives_the_same_bytes() {
    let folder = folder(MODEL, &data());
    let fitted = folder.jitai(FIT).succeeded();
    let environment = fitted.stdout.clone();
    let files = ["people.csv", "residuals.csv", "prior.toml", "fit.json"];
    let read = || files.map(|file| folder.read(&format!("fitted/{file}")));
    let first = read();
    folder.jitai(FIT).succeeded();
    assert_eq!(first, read());
    assert!(first[0].starts_with("person,sigma,b_dose,b_slot_now,b_1,g_1\nann,"), "{}", first[0]);
    assert!(first[1].starts_with("person,residual_minutes\nann,"), "{}", first[1]);
    assert!(first[2].contains("effect_means = ["), "{}", first[2]);
    // Another order of the rows gives the same people.
    let mut lines: Vec<&str> = HEADER.lines().collect();
    let all = data();
    let of_ann: Vec<&str> = all.lines().filter(|line| line.starts_with("ann")).collect();
    lines.extend(of_ann.iter().rev());
    lines.extend(all.lines().skip(1).filter(|line| line.starts_with("bob")));
    folder.write("pilot.csv", lines.join("\r\n"));
    folder.jitai(FIT).succeeded();
    assert_eq!(first[0], folder.read("fitted/people.csv"));
    let manifest = format!(
        "format = 1\nname = \"next\"\nscenarios = \"all\"\nseeds = 1\n{environment}[trial]\npeople = 10\ndays = 20\n\
         decisions_per_day = 2\n[evaluation]\non = \"trial\"\n[[agent]]\nname = \"random\"\nalgorithm = \"rule\"\nrule = \"random\"\n\
         [[agent]]\nname = \"bandit\"\nalgorithm = \"linear_thompson\"\npi_min = 0.1\n{}",
        first[2]
    );
    folder.write("next.toml", manifest);
    folder.jitai(["check", "--try", "next.toml"]).succeeded();
    folder.jitai(["run", "next.toml"]).succeeded().says("2 completed");
}

#[test]
fn residuals_are_replayed() {
    let model = MODEL
        .replace(
            "[linear]",
            "[replay]\norder = \"cyclic\"\ncolumns = [\"residual_minutes\"]\n[linear]",
        )
        .replace(
            "\"base + action * gain\", \"sigma\"",
            "\"base + action * gain + residual_minutes\", \"noise\"",
        );
    let folder = folder(&model, &data());
    let environment = folder.jitai(FIT).succeeded().stdout;
    assert!(environment.contains("replay = \"fitted/residuals.csv\""), "{environment}");
    let manifest = format!(
        "format = 1\nname = \"next\"\nscenarios = \"all\"\nseeds = 1\n{environment}[trial]\npeople = 2\ndays = 20\n\
         decisions_per_day = 2\n[evaluation]\non = \"trial\"\n[[agent]]\nname = \"random\"\nalgorithm = \"rule\"\nrule = \"random\"\n"
    );
    folder.write("next.toml", manifest);
    folder.jitai(["run", "next.toml"]).succeeded().says("1 completed");
}

#[test]
fn faults_of_data_say_where_they_are_all_at_once() {
    let good = data();
    let with = |from: &str, to: &str| good.replacen(from, to, 1);
    let cases: [(String, &[&str]); 20] = [
        (with("ann,1,0,0,0.4,1,20", "ann,1,0,0,0.4,1,many"), &["line 2", "`walked`", "`many`"]),
        (with("ann,1,0,0,0.4,1,20", "ann,1,0,0,0.4,1,\"20,5\""), &["line 2", "point, not a comma"]),
        (with("ann,1,0,0,0.4,1,20", "ann,2024-01-03,0,0,0.4,1,20"), &["line 2", "a date or time"]),
        (with("ann,1,1,", "ann,1,0,"), &["line 3: the same decision of person ann as line 2"]),
        (with("ann,1,1,", "ann,1,2,"), &["line 3", "decision of the day is 2, expected 0 to 1"]),
        (with("ann,1,0,0,0.4,1,20", "ann,1.5,0,0,0.4,1,20"), &["line 2", "whole number"]),
        (with("ann,1,0,0,0.4,1,20", "ann,,0,0,0.4,1,20"), &["line 2", "is missing"]),
        (with("ann,1,0,0,0.4,1,20", ",1,0,0,0.4,1,20"), &["line 2", "names the person"]),
        (with("ann,1,0,0,0.4,1,20", "ann,1,0,2,0.4,1,20"), &["line 2: the action is 2"]),
        (with("ann,1,0,0,0.4,1,20", "ann,1,0,0,1.4,1,20"), &["line 2: the probability is 1.4"]),
        (with("ann,1,1,1,0.4,1", "ann,1,1,1,0.4,0"), &["line 3: action 1 where available is 0"]),
        (with("ann,1,0,0,0.4,1,20", "ann,1,0,0,0.4,2,20"), &["available is 2"]),
        (with("ann,1,0,0,0.4,1,20", "ann,1,0,0,0.4,1"), &["line 2: 6 fields, and line 1 has 7"]),
        (good.replace(',', ";"), &["separated by semicolons"]),
        (
            good.replace("0.4", "40"),
            &[
                "is 40, expected a number from 0 to 1; for percentages, write probability = \"p / 100\"",
            ],
        ),
        (with("bob,1,0", "\"bob,1,0"), &["line 14: a quote opens here"]),
        (good.replacen(HEADER, "", 1), &["line 1: numbers, where the names of columns"]),
        (HEADER.to_owned(), &["at least one row"]),
        (String::new(), &["the file is empty"]),
        (
            with("ann,1,0,0,0.4,1,20", "ann,900000000,0,0,0.4,1,20"),
            &["`order` must count decisions"],
        ),
    ];
    for (data, expected) in cases {
        let folder = folder(MODEL, &data);
        let finished = folder.jitai(FIT).ended(2);
        for words in expected {
            assert!(finished.stderr.contains(words), "{words}: {}", finished.stderr);
        }
        assert!(!folder.path("fitted").exists());
    }
    // Lines of Windows are counted as others are.
    let windows = with("ann,1,1,", "ann,1,0,").replace('\n', "\r\n");
    folder(MODEL, &windows)
        .jitai(FIT)
        .ended(2)
        .says("line 3: the same decision of person ann as line 2");
    let folder = folder(MODEL, &good.replace("0.4,1,2", "often,1,x2"));
    folder
        .jitai(FIT)
        .ended(2)
        .says("`p` has `often`")
        .says("`walked` has `x2")
        .says("faults in pilot.csv");
}

#[test]
fn faults_of_the_section_have_lines_and_suggestions() {
    let cases: [(&str, &str, &[&str]); 12] = [
        ("person      = \"id\"\n", "", &["`person` is missing"]),
        ("\"walked\"", "\"waked\"", &["no column `waked`", "did you mean `walked`?"]),
        (
            "minutes = \"walked\"",
            "minute = \"walked\"",
            &["no variable `minute`", "did you mean `minutes`?"],
        ),
        ("action      = \"sent\"", "acton      = \"sent\"", &["[fit] has no key `acton`"]),
        ("columns     =", "method = \"mapp\"\ncolumns     =", &["\"least squares\", \"ridge\""]),
        (
            "columns     =",
            "method = { minuts = \"map\" }\ncolumns     =",
            &["is no draw that is fitted", "`minutes`"],
        ),
        ("columns     =", "effect = { standardized = 1 }\ncolumns     =", &["standardised"]),
        ("\"walked\"", "\"walked[-1]\"", &["no earlier decisions"]),
        (
            "\"walked\"",
            "\"walked +\"",
            &["`walked +`: the expression ends where a value is expected"],
        ),
        ("action * gain\"", "max(action * gain, 0)\"", &["`g_1`", "is not linear in it"]),
        (
            "{ gaussian = [\"base + action * gain\", \"sigma\"] }",
            "{ gamma = [\"base + action * gain\", \"sigma\"] }",
            &["a fit knows gaussian"],
        ),
        ("[fit]", "[fit.columns]\nslot_now = \"part\"\n[fti]", &["did you mean"]),
    ];
    for (from, to, expected) in cases {
        let folder = folder(&MODEL.replacen(from, to, 1), &data());
        let finished = folder.jitai(FIT).ended(2);
        for words in expected {
            assert!(finished.stderr.contains(words), "{words}: {}", finished.stderr);
        }
        assert!(finished.stderr.contains("world.toml"), "{}", finished.stderr);
    }
}

#[test]
fn columns_whose_names_are_no_words_are_suggested() {
    let data = data().replacen("part", "slot#", 1).replacen("walked", "min walked", 1);
    for (from, to, says) in [
        ("\"part\"]", "\"slot# - 1\"]", "the column `slot#` is `slot_` in an expression"),
        ("\"walked\"", "\"min walkd\"", "did you mean `min walked`?"),
    ] {
        let model =
            MODEL.replace("\"part\"]", "\"slot#\"]").replace("\"walked\"", "\"min walked\"");
        let model =
            model.replace(&from.replace("part", "slot#").replace("\"walked", "\"min walked"), to);
        folder(&model, &data).jitai(FIT).ended(2).says(says);
    }
}

#[test]
fn what_the_data_do_not_say_is_said_with_counts() {
    // A missing value, a gap, a person with one row, and one with equal values.
    let mut text = data().replacen("ann,1,0,0,0.4,1,20", "ann,1,0,0,0.4,1,", 1);
    text = text.replacen("bob,3,0,", "bob,30,0,", 1);
    // A code for a missing number.
    text = text.replacen("ann,2,0,0,0.4,1,24", "ann,2,0,0,0.4,1,-99", 1);
    text = text.replacen("ann,4,0,0,0.4,1,21", "ann,4,0,0,0.4,1,-99", 1);
    text += "cid,1,0,0,0.4,1,7\n";
    for decision in 0..12 {
        writeln!(text, "dee,{},{},{},1,1,9", decision / 2, decision % 2, decision % 3 % 2).unwrap();
    }
    let folder = folder(MODEL, &text);
    let finished = folder.jitai(FIT).succeeded();
    for words in [
        "decisions of 1 people are no rows of the file",
        "12 decisions have the probability 0 or 1, the first in line 27: they say",
        "`walked` is -99 in 2 rows, the first in line 4, which looks like a code",
        "1 without a value (the first in line 2) and 0 without a feature left out",
        "not more rows than coefficients: not estimated: cid",
        "all values are equal: cid, dee",
    ] {
        assert!(finished.stderr.contains(words), "{words}: {}", finished.stderr);
    }
    let people = folder.read("fitted/people.csv");
    assert!(!people.contains("cid") && people.contains("dee"), "{people}");
    // Without actions, effects are not identified.
    let folder = self::folder(MODEL, &data().replace(",1,0.4", ",0,0.4"));
    let says = folder.jitai(FIT).succeeded().stderr;
    assert!(
        says.contains("the action never varies") && says.contains("`g_1` is not identified"),
        "{says}"
    );
    // With a byte-order mark.
    let folder = self::folder(MODEL, &format!("\u{feff}{}", data()));
    folder.jitai(FIT).succeeded();
}

#[test]
fn nobody_with_estimates_is_an_error_and_writes_nothing() {
    let rows: Vec<String> = data().lines().take(3).map(|line| format!("{line}\n")).collect();
    let folder = folder(MODEL, &rows.concat());
    folder.jitai(FIT).ended(2).says("nobody has estimates of all coefficients");
    assert!(!folder.path("fitted").exists());
}

/// The page without its tags.
fn page(folder: &Folder) -> String {
    folder
        .read("fitted/index.html")
        .split('<')
        .filter_map(|part| Some(part.split_once('>')?.1))
        .collect()
}

#[test]
fn the_page_leads_with_what_the_data_do_not_say_and_compares_simulated_pilots() {
    let people = [("ann", 20), ("bob", 30), ("cem", 25), ("dot", 15), ("eve", 40), ("fay", 35)];
    let data = data_of(&people);
    let folder = folder(MODEL, &data);
    let fitted = folder.jitai(FIT).succeeded();
    assert!(!fitted.stderr.contains("not fitted"), "{}", fitted.stderr);
    let page = page(&folder);
    let place = |words: &str| page.find(words).unwrap_or_else(|| panic!("{words} is missing"));
    assert!(page.contains("Fitted: 6 of 6 people have all coefficients."), "{page}");
    assert!(place("What the data do not say") < place("The model against its data"));
    for words in [
        "share of zeros",
        "variance between people",
        "autocorrelation at lag 1",
        "decision 1 of the day",
        "a variance without zeros; 0.3 of 6 are expected.",
        "The effect of an action",
        "Held-out days",
        "Stability of the recursion",
        "family = &quot;declared&quot;",
    ] {
        place(words);
    }
    for file in
        ["figures/weeks.svg", "figures/people.pdf", "tables/against.csv", "tables/effect.csv"]
    {
        assert!(folder.path(&format!("fitted/{file}")).exists(), "{file}");
    }
    // Two people have no standard error of an effect.
    folder.write("pilot.csv", self::data());
    folder.jitai(FIT).succeeded();
    assert!(self::page(&folder).contains("The pilot has too few people for the effect"));
    // A model without an identified effect is not called fitted.
    folder.write("pilot.csv", data.replace(",1,0.4", ",0,0.4"));
    folder
        .jitai(FIT)
        .succeeded()
        .says("warning: not fitted: the effect `g_1` is not identified for 6 of 6 fits");
    assert!(self::page(&folder).contains("Not fitted: 6 of 6"));
}

#[test]
fn imputed_effects_carry_their_name_wherever_they_matter() {
    let model = MODEL.replace(
        "columns     =",
        "effect = { standardised = 0.5, negative = [\"g_1\"] }\ncolumns     =",
    );
    let folder = folder(&model, &data());
    folder.jitai(FIT).succeeded().says("imputed, not estimated: b_dose, g_1");
    let page = page(&folder);
    assert!(page.matches("imputed, not estimated: b_dose, g_1").count() >= 5, "{page}");
    assert!(!page.contains("fitted effect"), "{page}");
    let people = folder.read("fitted/people.csv");
    let header: Vec<&str> = people.lines().next().unwrap().split(',').collect();
    let effect = header.iter().position(|name| *name == "g_1").unwrap();
    let of = |line: &str| line.split(',').nth(effect).unwrap().parse::<f64>().unwrap();
    let effects: Vec<f64> = people.lines().skip(1).map(of).collect();
    assert!(effects.iter().all(|effect| *effect < 0.0 && *effect == effects[0]), "{people}");
}

#[test]
fn a_recursion_that_explodes_is_not_called_fitted() {
    let model = MODEL
        .replace("\"dose\", \"slot_now\"", "\"last\", \"slot_now\"")
        .replace("minutes  =", "last = \"default(minutes[-1], 0)\"\nminutes  =")
        .replace("days = 20", "days = 200");
    let mut text = HEADER.to_owned();
    let mut walked = 1.0;
    for decision in 0..12 {
        walked = 1.3 * walked + f64::from(decision * decision % 5) / 5.0;
        let sent = decision * 7 % 3 % 2;
        writeln!(text, "ann,{},{},{sent},0.4,1,{walked}", decision / 2, decision % 2).unwrap();
    }
    let folder = folder(&model, &text);
    folder.jitai(FIT).succeeded().says("warning: not fitted: the recursion explodes");
}

#[test]
fn drawn_people_are_swept_by_a_manifest() {
    let folder = folder(MODEL, &data());
    let with =
        |more: &[&'static str]| FIT.into_iter().chain(more.iter().copied()).collect::<Vec<_>>();
    let environment = folder.jitai(with(&["--draws", "3"])).succeeded().stdout;
    let read = || [1, 2, 3].map(|number| folder.read(&format!("fitted/draw-{number}.csv")));
    let drawn = read();
    assert!(drawn[0] != drawn[1] && drawn[1] != drawn[2]);
    let header = folder.read("fitted/people.csv").lines().next().unwrap().to_owned();
    assert!(drawn.iter().all(|text| text.starts_with(&header) && text.lines().count() == 3));
    folder.jitai(with(&["--draws", "3"])).succeeded();
    assert_eq!(drawn, read());
    let swept = "people = [\"fitted/draw-1.csv\", \"fitted/draw-2.csv\", \"fitted/draw-3.csv\"]";
    let manifest = format!(
        "format = 1\nname = \"next\"\nscenarios = \"all\"\nseeds = 1\n{}[trial]\npeople = 10\ndays = 20\ndecisions_per_day = 2\n\
         [evaluation]\non = \"trial\"\n[[agent]]\nname = \"random\"\nalgorithm = \"rule\"\nrule = \"random\"\n",
        environment.replace("people = \"fitted/people.csv\"", swept)
    );
    folder.write("next.toml", manifest);
    folder.jitai(["run", "next.toml"]).succeeded().says("3 completed");
    // Readers see the names of files, and programs the digests.
    folder.jitai(["report", "next.toml", "--out", "report"]).succeeded();
    let arms = folder.read("report/tables/next-arms.md");
    assert!(arms.contains("people=draw-2.csv") && !arms.contains("sha256"), "{arms}");
    assert!(folder.read("report/index.html").contains("people=draw-3.csv"));
    let arms = folder.read("report/tables/next-arms.csv");
    assert!(arms.contains("sha256:") && !arms.contains("draw-2.csv"), "{arms}");
    folder.jitai(with(&["--draws", "2", "--bootstrap"])).succeeded();
    let all = folder.read("fitted/people.csv");
    let own: Vec<&str> = all.lines().collect();
    assert!(folder.read("fitted/draw-1.csv").lines().all(|line| own.contains(&line)));
    folder.jitai(with(&["--bootstrap"])).ended(2).says("--draws");
}

#[test]
fn a_stop_ends_a_long_fit_promptly_and_writes_nothing() {
    let folder = folder(MODEL, &data());
    let mut words = FIT.to_vec();
    words.extend(["--simulations", "100000"]);
    let running = folder.start(words);
    std::thread::sleep(Duration::from_millis(500));
    let asked = Instant::now();
    running.signal("INT");
    let finished = running.wait();
    assert_prompt(asked);
    assert!(finished.code == Some(130) || finished.code == Some(0), "{:?}", finished.code);
    assert!(finished.code == Some(0) || !folder.path("fitted/people.csv").exists());
}

#[test]
fn a_replay_keeps_the_decision_of_the_day() {
    let model = MODEL
        .replace("[linear]", "[replay]\norder = \"cyclic\"\ncolumns = [\"hour\"]\n[linear]")
        .replace("columns     = {", "columns     = { hour = \"hour\",");
    let model = model.replace("\"minutes\"\nfeatures", "\"minutes\"\nstate = [\"hour\"]\nfeatures");
    // Mornings have 8, evenings 20; a row is missing, another has no hour, and the last evening is no row.
    let mut text = HEADER.trim_end().to_owned() + ",hour\n";
    for (index, line) in data().lines().skip(1).enumerate() {
        let hour = if index % 2 == 0 { "8" } else { "20" };
        match index {
            3 | 11 => {}
            6 => writeln!(text, "{line},").unwrap(),
            _ => writeln!(text, "{line},{hour}").unwrap(),
        }
    }
    let folder = folder(&model, &text);
    let environment = folder
        .jitai(FIT)
        .succeeded()
        .says("note: 3 rows of residuals.csv have something of the same decision of another day")
        .stdout
        .clone();
    let rows = folder.read("fitted/residuals.csv");
    let hours: Vec<&str> =
        rows.lines().skip(1).map(|line| line.split(',').nth(1).unwrap()).collect();
    assert_eq!(hours.len(), 24, "{rows}");
    assert!(hours.chunks(2).all(|day| day == ["8", "20"]), "{rows}");
    let manifest = format!(
        "format = 1\nname = \"next\"\nscenarios = \"all\"\nseeds = 1\n{environment}[trial]\npeople = 4\ndays = 20\n\
         decisions_per_day = 2\n[evaluation]\non = \"trial\"\nrecord_decisions = \"test\"\n[[agent]]\nname = \"random\"\n\
         algorithm = \"rule\"\nrule = \"random\"\n"
    );
    folder.write("next.toml", manifest);
    folder.jitai(["run", "next.toml"]).succeeded();
    let off =
        "SELECT count(*) FROM decision WHERE json_extract(state, '$.hour') <> 8 + 12 * (step % 2)";
    assert_eq!(folder.number(off), 0);
    assert_eq!(folder.number("SELECT count(*) FROM decision"), 160);
}
