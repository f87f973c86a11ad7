//! Tests of whole models: their faults, and their numbers beside a plain reference.

use std::sync::Arc;

use crate::env::contract;
use crate::env::declared::expression::{Binary, Expression, ExpressionNode, Summary, Unary};
use crate::env::declared::family::MODEL;
use crate::env::declared::model::{
    Clock, Definition, ModelFile, Moment, NamedExpression, NeededColumn, Referent,
};
use crate::env::declared::program::stream;
use crate::env::declared::rows::{PEOPLE, REPLAY};
use crate::env::declared::{DeclaredModel, World, grammar, read};
use crate::env::variates::Expansion;
use crate::env::{
    Action, Environment, EpisodeStatus, Family, LaneSet, LaneStreams, Simulation, VectorEnvironment,
};
use crate::key::{Content, Value};
use crate::rng::{Purpose, Stream};
use crate::state::{Resumable, StateReader, StateWriter};
use crate::text::Source;

/// A world with these files, at the defaults of its parameters.
fn environment(model: &str, people: &str, replay: &str) -> Environment {
    let content = |form, text: &str| match text {
        "" => Content::default(),
        text => Content::read(form, text).unwrap_or_else(|fault| panic!("{fault}")),
    };
    let values = [content(&MODEL, model), content(&PEOPLE, people), content(&REPLAY, replay)];
    let family = Family::named("declared").unwrap();
    let values: Vec<Value> =
        values.map(Value::Content).into_iter().chain([Value::Integer(0)]).collect();
    (family.read)(family, &values, &[]).unwrap()
}

fn world(model: &str, people: &str, replay: &str, lanes: usize) -> World {
    let environment = environment(model, people, replay);
    let declared: &DeclaredModel = environment.model().unwrap();
    declared.simulation(&"all".parse().unwrap(), 1, lanes)
}

/// The faults of a model, as its author reads them.
fn faults(text: &str) -> String {
    let faults = read::read(text).expect_err("the model is faulty");
    faults.of("m.toml", Source::new(text)).to_string()
}

/// A model with these lines of variables, and the outcome `y`.
fn with_variables(lines: &str) -> String {
    format!(
        "format = 1\ndays = 40\n[variables]\n{lines}\n[roles]\noutcome = \"y\"\nfeatures = [\"step\"]\n"
    )
}

/// A model with most of what there is.
const MANY: &str = r#"
format = 1
actions = ["nothing", "a walk", "a stretch"]
decisions_per_day = 3
days = 9

[parameters]
effect = 2
kept = 0.75

[person]
own = { gaussian = [0, "spread"] }

[linear]
base = { prefix = "b_", features = ["slot", "own*dose", "1"] }

[variables]
dose    = "kept * default(dose[-1], 0) + default(action[-1], 0)"
free    = { bernoulli = "if(slot == 2, 0.5, 1)" }
mood    = { uniform = [-1, "1 + 0.1 * slot"] }
often   = "if(step < 4, 0, count(y > 3, 4))"
recent  = "if(step < 3, 0, discounted_mean(y, kept, 3))"
all     = "default(mean(y), 0) + sum(action > 0)"
noise   = { gaussian = [0, 0.5] }
y       = "base + action * effect * (1 - 0.1 * dose) + mood + noise + 0.01 * (often + recent + all)"
left    = { bernoulli = "0.02 * (y > 0)" }

[roles]
outcome   = "y"
reward    = "y - 0.5 * (action > 0)"
available = "free"
ends      = "left"
features  = ["dose", "mood", { name = "slot", low = 0, high = 2 }]
"#;

const PEOPLE_OF_MANY: &str = "person,spread,b_slot,b_own*dose,b_1\na,1,0.5,0.1,2\nb,0,-0.5,0.2,3\n";

#[test]
fn a_world_keeps_the_contract_of_environments() {
    contract::check(|lanes| world(MANY, PEOPLE_OF_MANY, "", lanes), 200).unwrap();
}

/// The values of a model of one person by the definitions alone; `None` for a missing number.
struct Plain<'m> {
    model: &'m ModelFile,
    parameters: Vec<f64>,
    people: Vec<Option<f64>>,
    /// \[decisions\], each \[quantities\].
    past: Vec<Vec<Option<f64>>>,
    now: Vec<Option<f64>>,
}

impl Plain<'_> {
    fn target(&self, target: Referent, back: u32) -> Option<f64> {
        let (time, per_day) = (self.past.len(), self.model.decisions_per_day as usize);
        match target {
            Referent::One => Some(1.0),
            Referent::ModelParameter(index) => Some(self.parameters[index]),
            Referent::Column(index) => self.people[index],
            Referent::Clock(Clock::Step) => Some(time as f64),
            Referent::Clock(Clock::Day) => Some((time / per_day) as f64),
            Referent::Clock(Clock::Slot) => Some((time % per_day) as f64),
            Referent::Clock(Clock::CalendarDay) => None,
            Referent::Quantity(index) if back == 0 => self.now[index],
            Referent::Quantity(index) => self.past[time.checked_sub(back as usize)?][index],
        }
    }

    fn formula(&self, formula: &NamedExpression) -> Option<f64> {
        let root = formula.expression.nodes.len() - 1;
        self.node(formula, root).filter(|value| !value.is_nan())
    }

    fn node(&self, formula: &NamedExpression, index: usize) -> Option<f64> {
        let value = |index: usize| self.node(formula, index).filter(|value| !value.is_nan());
        let truth = |is_true: bool| Some(f64::from(u8::from(is_true)));
        match &formula.expression.nodes[index] {
            ExpressionNode::Number(value) => Some(*value),
            ExpressionNode::WrittenName(name) => {
                self.target(formula.targets[*name], formula.expression.names[*name].back)
            }
            ExpressionNode::Unary(function, of) => {
                let x = value(*of)?;
                match function {
                    Unary::Minus => Some(-x),
                    Unary::Not => truth(x == 0.0),
                    Unary::Abs => Some(x.abs()),
                    Unary::Exp => Some(x.exp()),
                    Unary::Log => (x > 0.0).then(|| x.ln()),
                    Unary::Sqrt => (x >= 0.0).then(|| x.sqrt()),
                    Unary::Sigmoid => Some(1.0 / (1.0 + (-x).exp())),
                    Unary::NormalCdf => Some(0.5 * libm::erfc(-x / 2f64.sqrt())),
                    Unary::Floor => Some(x.floor()),
                    Unary::Round => Some(x.round()),
                }
            }
            ExpressionNode::Binary(Binary::Default, [x, y]) => value(*x).or_else(|| value(*y)),
            ExpressionNode::Binary(function, [x, y]) => {
                let (x, y) = (value(*x)?, value(*y)?);
                match function {
                    Binary::Plus => Some(x + y),
                    Binary::Minus => Some(x - y),
                    Binary::Times => Some(x * y),
                    Binary::Divided => (y != 0.0).then(|| x / y),
                    Binary::Modulo => (y != 0.0).then(|| x - y * (x / y).floor()),
                    Binary::Power => Some(x.powf(y)).filter(|_| x != 0.0 || y >= 0.0),
                    Binary::Less => truth(x < y),
                    Binary::AtMost => truth(x <= y),
                    Binary::Greater => truth(x > y),
                    Binary::AtLeast => truth(x >= y),
                    Binary::Equal => truth(x == y),
                    Binary::Unequal => truth(x != y),
                    Binary::And => truth(x != 0.0 && y != 0.0),
                    Binary::Or => truth(x != 0.0 || y != 0.0),
                    Binary::Min => Some(x.min(y)),
                    Binary::Max => Some(x.max(y)),
                    Binary::Default => unreachable!(),
                }
            }
            ExpressionNode::If([condition, one, other]) => {
                if value(*condition)? != 0.0 {
                    value(*one)
                } else {
                    value(*other)
                }
            }
            ExpressionNode::PastWindow(window) => {
                let before = formula.expression.nodes[..index].iter();
                let place =
                    before.filter(|node| matches!(node, ExpressionNode::PastWindow(_))).count();
                let quantity = formula.windows[place];
                let length = window.length.map_or(self.past.len(), |length| length as usize);
                let first = self.past.len().checked_sub(length)?;
                let values: Option<Vec<f64>> =
                    self.past[first..].iter().map(|then| then[quantity]).collect();
                let values = values?;
                let factor = window.factor.as_ref().map_or(1.0, |factor| {
                    let of_name = |index: usize| {
                        let name = &factor.names[index].text;
                        let mut parameters = self.model.parameters.iter();
                        Some(parameters.find(|one| one.name == *name)?.default)
                    };
                    super::numbers::constant(factor, &of_name).unwrap()
                });
                let ages = (0..values.len()).rev();
                let weights: Vec<f64> = ages.map(|age| factor.powi(age as i32)).collect();
                let sum: f64 = values.iter().zip(&weights).map(|(x, w)| x * w).sum();
                match window.summary {
                    Summary::Mean => {
                        (!values.is_empty()).then(|| sum / weights.iter().sum::<f64>())
                    }
                    Summary::Sum | Summary::Count => Some(sum),
                }
            }
        }
    }

    /// Computes a stage with this word.
    fn compute(&mut self, stage: Moment, word: u64) {
        for index in &self.model.order[stage as usize] {
            let quantity = &self.model.quantities[*index];
            let mut words = Expansion(word ^ stream(&quantity.name));
            self.now[*index] = match &quantity.definition {
                Definition::Action | Definition::Probability => continue,
                Definition::NamedExpression(formula) => self.formula(formula),
                Definition::DrawInstruction(distribution, formulas) => {
                    let parameters: Option<Vec<f64>> =
                        formulas.iter().map(|formula| self.formula(formula)).collect();
                    let word = words.0;
                    parameters
                        .filter(|all| {
                            let ranges = (0..all.len()).map(|index| distribution.range(index));
                            all.iter()
                                .zip(ranges)
                                .all(|(x, (least, most))| *x >= least && *x <= most)
                        })
                        .map(|all| {
                            let columns: Vec<[f64; 1]> = all.iter().map(|x| [*x]).collect();
                            let columns: Vec<&[f64]> = columns.iter().map(|one| &one[..]).collect();
                            let mut out = [0.0];
                            match distribution {
                                super::distribution::DrawLaw::Gaussian => {
                                    out[0] = all[0] + all[1] * words.normal();
                                }
                                other => other.draw(&columns, (&[word], 0), &[true], &mut out),
                            }
                            out[0]
                        })
                }
                Definition::Linear(terms) => terms
                    .iter()
                    .map(|term| {
                        let factors = term.factors.iter().map(|factor| self.target(*factor, 0));
                        let factors: Option<Vec<f64>> = factors.collect();
                        Some(self.target(term.coefficient, 0)? * factors?.iter().product::<f64>())
                    })
                    .sum(),
                Definition::Replay(_) | Definition::ProbabilityTable(..) => unreachable!(),
            };
        }
    }
}

/// Compares every number of a model with the plain reference, over a whole episode of one person.
fn compare(text: &str, people: &str, row: &[f64], seed: u64) {
    let mut world = world(text, people, "", 3);
    let model = read::read(text).unwrap_or_else(|_| unreachable!());
    let own = Stream::new(seed, Purpose::Environment);
    let streams: Vec<Stream> =
        (0..3).map(|lane| Stream::of_person(seed, Purpose::Person, lane)).collect();
    let mut words = streams[1].clone();
    let mut streams = LaneStreams::PerLane(streams);
    world.assign(&[0, 0, 0]);
    world.reset(LaneSet::All, &mut streams);
    let [_, person_word, ..] = words.next_participant();
    let parameters = model.parameters.iter().map(|one| one.default).collect();
    let mut plain = Plain {
        model: &model,
        parameters,
        people: row.iter().map(|x| Some(*x)).collect(),
        past: Vec::new(),
        now: vec![None; model.quantities.len()],
    };
    let mut word = words.bits();
    let mut choices = own;
    let count = world.action_spec().count as u32;
    let mut rewards = [0.0; 3];
    plain.compute(Moment::Person, person_word);
    for time in 0..model.horizon() {
        plain.compute(Moment::Before, word);
        let actions = [(); 3].map(|()| Action::from_index(choices.below(count) as usize).unwrap());
        let can_send = world.can_send(1);
        let taken = if can_send { actions[1].index() } else { 0 };
        world.step(&actions, &mut rewards, &mut streams);
        word = words.bits();
        plain.now[0] = Some(taken as f64);
        // Unknown where a message can be sent; none is sent elsewhere.
        plain.now[1] = (!can_send).then_some(0.0);
        plain.compute(Moment::After, word);
        for (index, quantity) in model.quantities.iter().enumerate() {
            let is_told = matches!(quantity.definition, Definition::Probability);
            if quantity.stage != Moment::After || is_told {
                continue;
            }
            let (found, expected) = (world.quantity(index, 1), plain.now[index]);
            let is_same = match expected {
                None => found.is_nan(),
                Some(expected) if !expected.is_finite() => !found.is_finite(),
                Some(expected) => (found - expected).abs() <= 1e-9 * expected.abs().max(1.0),
            };
            assert!(
                is_same,
                "`{}` at {time}: {found}, expected {expected:?}\n{text}",
                quantity.name
            );
        }
        plain.past.push(plain.now.clone());
        if world.statuses()[1] != EpisodeStatus::Running {
            break;
        }
    }
}

#[test]
fn numbers_are_those_of_a_plain_reference() {
    for seed in 1..6 {
        compare(MANY, PEOPLE_OF_MANY, &[1.0, 0.5, 0.1, 2.0], seed);
    }
}

#[test]
fn a_world_with_a_week_of_memory_and_a_regime_has_the_numbers_of_the_plain_reference() {
    // People whose prompts wear off, a day of memory, averages of a week, and coefficients by person.
    let text = include_str!("../../../experiments/oralytics/v1.toml");
    let people = include_str!("../../../experiments/oralytics/synthetic_v1.csv");
    let model = read::read(text).unwrap();
    let mut lines = people.lines().skip(1).map(|line| line.split(',').collect::<Vec<_>>());
    let (names, first) = (lines.next().unwrap(), lines.next().unwrap());
    let number = |column: &NeededColumn| {
        let index = names.iter().position(|name| *name == column.name);
        first[index.unwrap_or_else(|| panic!("{} is a column", column.name))].parse().unwrap()
    };
    let row: Vec<f64> = model.columns.iter().map(number).collect();
    for (seed, after) in [(1, "0.5"), (2, "0"), (3, "0.8")] {
        let text = text.replace(
            "effect_after_shrinking   = 0.5",
            &format!("effect_after_shrinking = {after}"),
        );
        compare(&text, people, &row, seed);
    }
}

/// A random expression of names and functions.
fn expression(random: &mut Stream, depth: u32) -> String {
    let names = ["v0", "v1", "v2", "action", "e"];
    if depth == 0 || random.below(5) == 0 {
        return match random.below(6) {
            0 => format!("{}", random.below(7)),
            1 => ["step", "day", "slot", "p"][random.below(4) as usize].to_owned(),
            2 => "0.25".to_owned(),
            _ => format!("{}[-{}]", names[random.below(5) as usize], 1 + random.below(3)),
        };
    }
    let mut next = || expression(random, depth - 1);
    let (one, other, third) = (next(), next(), next());
    let signs = ["+", "-", "*", "/", "%", "^", "<", "<=", ">", ">=", "==", "!=", "and", "or"];
    let unary =
        ["abs", "exp", "log", "sqrt", "sigmoid", "normal_cdf", "floor", "round", "not", "-"];
    match random.below(9) {
        0 => format!("{}({one})", unary[random.below(10) as usize]),
        1 => format!("if({one}, {other}, {third})"),
        2 => format!("default({one}, {other})"),
        3 => format!("clip({one}, {other}, {third})"),
        4 => format!("min({one}, {other}, {third}) - max({one}, {other})"),
        5 => format!("mean({one}, {})", 1 + random.below(4)),
        6 => format!("sum({one}) + default(mean({other}), 1)"),
        _ => format!("({one}) {} ({other})", signs[random.below(14) as usize]),
    }
}

#[test]
fn random_models_have_the_numbers_of_the_plain_reference() {
    let mut random = Stream::new(5, Purpose::Environment);
    let mut compared = 0;
    for seed in 0..300 {
        // Missing numbers are compared as well, and reach neither a role nor a record.
        let lines: Vec<String> =
            (0..3).map(|place| format!("v{place} = \"{}\"", expression(&mut random, 3))).collect();
        let text = format!(
            "format = 1\ndays = 4\ndecisions_per_day = 3\n[parameters]\np = 2\n[variables]\n{}\ne = {{ gaussian = [0, 1] }}\n\
             y = \"default(v0, 0) + default(v1, 0) + default(v2, 0) + p + e + action\"\n[roles]\noutcome = \"y\"\n\
             state = [\"e\"]\nfeatures = [\"step\"]\n",
            lines.join("\n")
        );
        if read::read(&text).is_ok() {
            compare(&text, "", &[], seed);
            compared += 1;
        }
    }
    assert!(compared > 200, "{compared}");
}

#[test]
fn texts_that_are_no_models_never_panic() {
    let mut random = Stream::new(6, Purpose::Environment);
    let pieces = [
        "x",
        "[-1]",
        "(",
        ")",
        ",",
        "+",
        "if(",
        "mean(",
        "and",
        "not ",
        "1e400",
        "é",
        "\"",
        "[-9]",
        "^",
        "-",
        "0.5",
        "=",
        "max(",
        "default(",
        "discounted_mean(",
        "😀",
        "\n",
        "clip(",
    ];
    for _ in 0..3000 {
        let count = 1 + random.below(9);
        let text: String = (0..count).map(|_| pieces[random.below(24) as usize]).collect();
        if let Err(fault) = grammar::read(&text) {
            assert!(fault.span.start <= fault.span.end && fault.span.end <= text.len(), "{text}");
            let _ = &text[fault.span];
        }
    }
    let mut bytes = MANY.as_bytes().to_vec();
    for _ in 0..2000 {
        let at = random.below(bytes.len() as u32) as usize;
        let old = std::mem::replace(&mut bytes[at], b" =\"[]{}().-19ax"[random.below(15) as usize]);
        if let Ok(text) = std::str::from_utf8(&bytes)
            && let Err(faults) = read::read(text)
        {
            let _ = faults.of("m.toml", Source::new(text)).to_string();
        }
        bytes[at] = old;
    }
}

#[test]
fn operators_bind_as_in_mathematics() {
    let value = |text: &str| {
        let Expression { .. } = grammar::read(text).unwrap();
        super::numbers::constant(&grammar::read(text).unwrap(), &|_| None).unwrap()
    };
    for (text, expected) in [
        ("1 + 2 * 3", 7.0),
        ("2 * 3 ^ 2", 18.0),
        ("-2 ^ 2", -4.0),
        ("2 ^ 3 ^ 2", 512.0),
        ("8 - 3 - 2", 3.0),
        ("7 % 4 + 1", 4.0),
        ("-1 % 14", 13.0),
        ("1 < 2 and not 3 < 2 or 0", 1.0),
        ("not 1 == 2", 1.0),
        ("min(3, 1, 2) + max(1, 5, 2)", 6.0),
        ("clip(7, 0, 5) + clip(-1, 0, 5)", 5.0),
        ("if(1 > 2, 10, if(2 > 1, 20, 30))", 20.0),
        ("default(1 / 0, 4)", 4.0),
        ("default(log(0), 3) + default(sqrt(-1), 2)", 5.0),
        ("round(2.5) + round(-2.5) + floor(-0.5)", -1.0),
        ("(1 + 2) * (3 + 4)", 21.0),
    ] {
        assert_eq!(value(text), expected, "{text}");
    }
}

#[test]
fn faults_have_their_positions_and_remedies() {
    let model = with_variables(
        "a = \"b + 1\"\nb = \"c[-1] + a\"\nc = \"a +\"\nd = { gausian = [0, 1] }\ny = { bernoulli = 1.5 }\nstep = \"1\"",
    );
    let says = faults(&model);
    for part in [
        "m.toml:4:1: a cycle: `a` needs `b` needs `a`",
        "m.toml:6:9: `c`: the expression ends where a value is expected",
        "m.toml:7:7: `d`: there is no distribution `gausian`",
        "did you mean `gaussian`?",
        "m.toml:8:19: `y`: probability is a number from 0 to 1, found 1.5",
        "m.toml:9:1: `step` cannot name a variable: it is a clock",
    ] {
        assert!(says.contains(part), "{part}\n{says}");
    }
    for (line, part) in [
        ("y = \"1 < 2 < 3\"", "write two comparisons"),
        ("y = \"x[-1, 0]\"", "default(x[-1], 0)"),
        ("y = \"step[-1]\"", "a clock has no lag: write step - 1"),
        ("y = \"y[-1000000000]\"", "the lag: expected a whole number from 1 to 10000"),
        (
            "y = \"default(mean(y, 41), 0)\"",
            "a window of 41 decisions is never full: a person has 40",
        ),
        ("y = \"1e400\"", "too large for a number"),
        ("y = \"2 x\"", "a product needs `*`"),
        ("y = \"a && b\"", "`&&` is written `and` here"),
        ("y = \"(1\"", "this bracket is not closed"),
        ("y = \"1\u{a0}+ 100\"", "this space is not the one of the keyboard"),
        ("y = \"default(y[-40], 0)\"", "a lag of 40 decisions: a person has 40"),
        ("policy = \"1\"\ny = \"policy\"", "a number that a trial records"),
        (
            "y = \"1\"\n[person]\na = { gaussian = [\"y[-1]\", 1] }",
            "refers to what changes between decisions",
        ),
        ("y = \"f(1)\"", "there is no function `f`"),
        ("y = \"if(1, 2)\"", "`if` takes a condition and two values"),
        ("y = \"z[-1]\"", "there is no variable `z`"),
        ("y = { gaussian = [0, -1] }", "sd is a number of at least 0, found -1"),
        ("y = { gaussian = [0] }", "expected the parameters mean, sd"),
        ("step = \"1\"\ny = \"1\"", "`step` cannot name a variable: it is a clock"),
    ] {
        let says = faults(&with_variables(line));
        assert!(says.contains(part), "{line}: {says}");
    }
    let deep = format!("y = \"{}1{}\"", "(".repeat(500), ")".repeat(500));
    assert!(faults(&with_variables(&deep)).contains("more than 100 brackets"));
    let long = format!("y = \"1{}\"", " + 1".repeat(10_000));
    assert!(faults(&with_variables(&long)).contains("the maximum is 20000"));
    let powers = format!("y = \"1{}\"", " + step ^ 2 - -1".repeat(200));
    assert!(read::read(&with_variables(&powers)).is_ok());
    // Chains of one operator are no nests.
    let wide = format!("y = \"1{}\"", "+1".repeat(9_000));
    assert!(read::read(&with_variables(&wide)).is_ok());
}

/// Plays a world with actions that depend on person and time alone; returns the recorded states after each step.
fn played(world: &mut World, streams: &mut LaneStreams, steps: u32, shift: usize) -> Vec<f64> {
    let lanes = world.lanes();
    let (mut states, mut rewards) = (Vec::new(), vec![0.0; lanes]);
    for step in 0..steps {
        let action = |lane: usize| Action::from_index((lane + step as usize + shift) % 3).unwrap();
        let actions: Vec<Action> = (0..lanes).map(action).collect();
        world.step(&actions, &mut rewards, streams);
        for (lane, reward) in rewards.iter().enumerate() {
            world.record_state(lane, &mut states);
            states.push(*reward);
        }
    }
    states
}

fn streams(lanes: u32) -> LaneStreams {
    LaneStreams::PerLane(
        (0..lanes).map(|lane| Stream::of_person(7, Purpose::Person, lane)).collect(),
    )
}

#[test]
fn a_person_does_not_depend_on_the_number_of_lanes() {
    let of = |lanes: usize| {
        let (mut world, mut streams) =
            (world(MANY, PEOPLE_OF_MANY, "", lanes), streams(lanes as u32));
        world.reset(LaneSet::All, &mut streams);
        played(&mut world, &mut streams, 12, 0)
    };
    let (one, many) = (of(1), of(300));
    let width = one.len() / 12;
    for step in 0..12 {
        let alone = &one[step * width..(step + 1) * width];
        let among = &many[step * 300 * width..][..width];
        assert_eq!(
            alone.iter().map(|x| x.to_bits()).collect::<Vec<_>>(),
            among.iter().map(|x| x.to_bits()).collect::<Vec<_>>()
        );
    }
}

#[test]
fn a_world_resumes_from_its_saved_state() {
    let (mut first, mut draws) = (world(MANY, PEOPLE_OF_MANY, "", 5), streams(5));
    first.reset(LaneSet::All, &mut draws);
    played(&mut first, &mut draws, 7, 0);
    let mut bytes = Vec::new();
    first.save(&mut StateWriter::new(&mut bytes)).unwrap();
    let mut second = world(MANY, PEOPLE_OF_MANY, "", 5);
    second.restore(&mut StateReader::new(&mut &bytes[..])).unwrap();
    let mut same = draws.clone();
    let bits = |states: Vec<f64>| states.into_iter().map(f64::to_bits).collect::<Vec<_>>();
    assert_eq!(
        bits(played(&mut first, &mut draws, 9, 0)),
        bits(played(&mut second, &mut same, 9, 0))
    );
}

#[test]
fn another_policy_and_another_variable_leave_every_draw_as_it_is() {
    let drawn = |text: &str, names: &[&str], shift: usize| {
        let (mut world, mut streams) = (world(text, PEOPLE_OF_MANY, "", 4), streams(4));
        world.reset(LaneSet::All, &mut streams);
        let indices: Vec<usize> = names.iter().map(|name| world.named(name)).collect();
        let mut draws = Vec::new();
        for step in 0..5 {
            let _ = played(&mut world, &mut streams, 1, shift + step);
            draws.extend(indices.iter().flat_map(|index| {
                (0..4).map(|lane| world.quantity(*index, lane).to_bits()).collect::<Vec<_>>()
            }));
        }
        draws
    };
    let lasting = MANY.replace("0.02 * (y > 0)", "0 * y");
    let names = ["own", "free", "mood", "noise"];
    let more = lasting
        .replace("[roles]", "other = { gaussian = [0, 1] }\n[roles]")
        .replace("0.5 * (action > 0)", "0.5 * (action > 0) - other");
    assert_eq!(drawn(&lasting, &names, 0), drawn(&lasting, &names, 1));
    assert_eq!(drawn(&lasting, &names, 0), drawn(&more, &names, 0));
}

#[test]
fn people_who_begin_among_many_have_the_numbers_of_people_alone() {
    const LANES: u32 = 300;
    let mut together = world(MANY, PEOPLE_OF_MANY, "", LANES as usize);
    let mut alone: Vec<World> = (0..LANES).map(|_| world(MANY, PEOPLE_OF_MANY, "", 1)).collect();
    let mut streams = streams(LANES);
    let LaneStreams::PerLane(own) = &streams else { unreachable!() };
    let mut own: Vec<LaneStreams> =
        own.iter().map(|stream| LaneStreams::PerLane(vec![stream.clone()])).collect();
    // Many, then few far from one another, then none at the beginning of the lanes.
    let mut begins: Vec<bool> = (0..LANES).map(|lane| lane % 3 > 0 && lane > 40).collect();
    let mut choices = Stream::new(7, Purpose::Exploration);
    let (mut rewards, mut reward) = (vec![0.0; LANES as usize], [0.0]);
    let mut few = 0;
    for time in 0..60 {
        together.reset(LaneSet::Masked(&begins), &mut streams);
        for (lane, _) in begins.iter().enumerate().filter(|(_, begins)| **begins) {
            alone[lane].reset(LaneSet::All, &mut own[lane]);
        }
        let count = begins.iter().filter(|begins| **begins).count();
        few += usize::from((1..LANES as usize / 4).contains(&count));
        let actions: Vec<Action> =
            (0..LANES).map(|_| Action::from_index(choices.below(3) as usize).unwrap()).collect();
        let mut bytes = Vec::new();
        if time == 30 {
            together.save(&mut StateWriter::new(&mut bytes)).unwrap();
            together = world(MANY, PEOPLE_OF_MANY, "", LANES as usize);
            together.restore(&mut StateReader::new(&mut &bytes[..])).unwrap();
        }
        together.step(&actions, &mut rewards, &mut streams);
        for (lane, alone) in alone.iter_mut().enumerate() {
            alone.step(&actions[lane..=lane], &mut reward, &mut own[lane]);
            assert_eq!(reward[0].to_bits(), rewards[lane].to_bits(), "lane {lane} at {time}");
            assert_eq!(alone.statuses()[0], together.statuses()[lane], "lane {lane} at {time}");
            let bits = |features: &[f64]| features.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
            let (mut one, mut other) = (Vec::new(), Vec::new());
            let unread = together.observation_spec().observations();
            alone.exact_features(0, &unread, &mut one);
            together.exact_features(lane, &unread, &mut other);
            assert_eq!(bits(&one), bits(&other), "lane {lane} at {time}");
        }
        // Some wait before they begin again.
        begins =
            together.statuses().iter().map(|status| *status != EpisodeStatus::Running).collect();
        for (lane, begins) in begins.iter_mut().enumerate() {
            *begins &= (lane + time) % 5 == 0;
        }
    }
    assert!(few > 10, "{few}");
}

#[test]
fn a_missing_number_stops_the_simulation_with_its_place() {
    let model = with_variables(
        "x = \"if(step < 3, 1, log(2 - step))\"\ny = { gaussian = [\"x + action\", \"1 - 0.1 * x\"] }",
    );
    let environment = environment(&model, "", "");
    let declared: &DeclaredModel = environment.model().unwrap();
    let mut world = declared.simulation(&"all".parse().unwrap(), 1, 2);
    let mut draws = streams(2);
    world.reset(LaneSet::All, &mut draws);
    let mut rewards = [0.0; 2];
    for time in 0..4 {
        assert_eq!(environment.failure().is_some(), time == 3);
        world.step(&[Action::default(); 2], &mut rewards, &mut draws);
    }
    let says = environment.failure().unwrap();
    assert_eq!(says, "model: `x` is missing for person 1 at decision 3; step = 3");
    assert!(environment.fresh().unwrap().failure().is_none());
    let model = with_variables("y = { gaussian = [\"action\", \"1 - 0.5 * step\"] }");
    let environment = self::environment(&model, "", "");
    let declared: &DeclaredModel = environment.model().unwrap();
    let mut world = declared.simulation(&"all".parse().unwrap(), 1, 1);
    let mut draws = streams(1);
    world.reset(LaneSet::All, &mut draws);
    (0..4).for_each(|_| world.step(&[Action::default()], &mut [0.0], &mut draws));
    let says = environment.failure().unwrap();
    assert_eq!(
        says,
        "model: sd of `y` is -0.5, expected a number of at least 0 for person 1 at decision 3; step = 3"
    );
}

#[test]
fn a_lag_without_a_value_is_a_fault_where_a_number_is_needed() {
    let fault = |lines: &str| faults(&with_variables(lines));
    let found = fault("x = \"x[-1] + 1\"\ny = { gaussian = [\"x + action\", 1] }");
    let says = "m.toml:4:6: `x[-1]` has no value at decision 0, where `x` is recorded";
    assert!(found.contains(says), "{found}");
    assert!(found.contains("default(x[-1], 0), or if(step < 1, 0, x[-1])"), "{found}");
    // Guarded for one decision, which is one too few.
    let found = fault("x = \"if(step < 1, 0, y[-2])\"\ny = { gaussian = [\"x + action\", 1] }");
    assert!(found.contains("`y[-2]` has no value at decision 1, where `x` is recorded"), "{found}");
    let found = fault("x = \"mean(y, 3)\"\ny = { gaussian = [\"x + action\", 1] }");
    let says = "this window of 3 decisions has no value at decision 0, where `x` is recorded";
    assert!(found.contains(says) && found.contains("if(step < 3, 0, …)"), "{found}");
    // What is missing in a draw is missing in the draw.
    let silent = with_variables("x = \"y[-1]\"\ny = { gaussian = [\"x + action\", 1] }");
    let found = faults(&silent.replace("outcome = \"y\"", "outcome = \"y\"\nstate = []"));
    let says = "`y[-1]` has no value at decision 0, where `roles.outcome` needs it";
    assert!(found.contains(says), "{found}");
    // Nobody is hurt whose model may have a value.
    for lines in [
        "x = \"if(step < 2, 0, y[-2])\"\ny = { gaussian = [\"x + action\", 1] }",
        "x = \"if(slot == 0 and day == 0, 0, y[-1])\"\ny = { gaussian = [\"x + action\", 1] }",
        "x = \"sum(y) + default(mean(y), 0)\"\ny = { gaussian = [\"x + action\", 1] }",
        "x = \"if(action == 1, default(y[-1], 0), 2)\"\ny = { gaussian = [\"x + action\", 1] }",
        "z = { bernoulli = 0.5 }\nx = \"if(z, 0, y[-1])\"\ny = { gaussian = [\"x + action\", 1] }",
    ] {
        read::read(&with_variables(lines)).unwrap();
    }
    // Nor one whose draw a parameter switches off, or whose people leave before.
    let switched = with_variables(
        "noise = { gaussian = [\"y[-1]\", 1] }\ny = { gaussian = [\"action + if(memory, noise, 0)\", 1] }",
    );
    let switched = switched
        .replace("days = 40", "days = 40\n[parameters]\nmemory = 0")
        .replace("outcome = \"y\"", "outcome = \"y\"\nstate = [\"y\"]");
    assert_eq!(environment(&switched, "", "").failure(), None);
    let early =
        with_variables("x = \"if(step < 2, 0, y[-4])\"\ny = { gaussian = [\"x + action\", 1] }");
    let early = early.replace("outcome = \"y\"", "outcome = \"y\"\nends = \"step >= 1\"");
    read::read(&early).unwrap();
}

#[test]
fn a_draw_that_parameters_make_impossible_is_found_where_it_is_needed() {
    let model = |lines: &str| {
        let text =
            with_variables(lines).replace("days = 40", "days = 40\n[parameters]\np = 2\nq = 0");
        read::read(&text).unwrap()
    };
    let found = |lines: &str, parameters: [f64; 2]| {
        super::program::impossible_draws(&model(lines), &parameters)
            .into_iter()
            .map(|(_, parameter, value)| (parameter, value))
            .collect::<Vec<_>>()
    };
    let draw = "y = { bernoulli = \"p / 2 + q\" }";
    assert_eq!(found(draw, [2.0, 0.5]), [(0, 1.5)]);
    assert_eq!(found(draw, [1.0, 0.5]), []);
    // Nobody is hurt whose probability varies, or whose draw another parameter switches off.
    assert_eq!(found("y = { bernoulli = \"p * (step > 50) + q\" }", [2.0, 0.5]), []);
    let switched = "x = { bernoulli = \"p\" }\ny = { gaussian = [\"if(q, x, action)\", 1] }";
    let text = with_variables(switched)
        .replace("days = 40", "days = 40\n[parameters]\np = 2\nq = 0")
        .replace("outcome = \"y\"", "outcome = \"y\"\nstate = [\"y\"]");
    let model = read::read(&text).unwrap();
    assert_eq!(super::program::impossible_draws(&model, &[2.0, 0.0]), []);
    assert_eq!(super::program::impossible_draws(&model, &[2.0, 1.0]).len(), 1);
}

#[test]
fn the_page_of_models_lists_every_word_of_the_grammar() {
    let page = include_str!("../../../docs/models.md");
    for form in &super::distribution::FORMS {
        let row = page.lines().find(|line| line.starts_with(&format!("| `{}` |", form.name)));
        let row = row.unwrap_or_else(|| panic!("{} has a row", form.name));
        for key in form.keys {
            assert!(row.contains(&format!("`{key}`")), "{}: {key}", form.name);
        }
    }
    let words = super::expression::FUNCTIONS.map(|(name, _)| name);
    for name in words.into_iter().chain(Clock::NAMED.map(|(name, _)| name)) {
        let is_listed = page.contains(&format!("`{name}`")) || page.contains(&format!("`{name}("));
        assert!(is_listed || page.contains(&format!(" {name}`")), "{name}");
    }
    for key in read::KEYS {
        assert!(
            page.contains(&format!("`{key}`")) || page.contains(&format!("`[{key}]`")),
            "{key}"
        );
    }
}

/// The first numbers of a variable of a world without chance, of one person.
fn numbers(lines: &str, name: &str, count: usize) -> Vec<f64> {
    let mut world = world(&with_variables(lines), "", "", 1);
    let mut draws = streams(1);
    world.reset(LaneSet::All, &mut draws);
    let index = world.named(name);
    (0..count)
        .map(|_| {
            world.step(&[Action::from_index(1).unwrap()], &mut [0.0], &mut draws);
            world.quantity(index, 0)
        })
        .collect()
}

#[test]
fn means_are_exact_where_their_numbers_are() {
    // The sum of seven ones among fourteen is seven, and half of fourteen.
    let half = "x = \"step % 2\"\ny = \"if(step < 14, -1, mean(x, 14)) + 0 * action\"";
    assert_eq!(numbers(half, "y", 16)[14..], [0.5, 0.5]);
    let ones = "y = \"(if(step < 10, 0, mean(action, 10)) == 1) + 0 * action\"";
    assert_eq!(numbers(ones, "y", 12)[9..], [0.0, 1.0, 1.0]);
}

#[test]
fn draws_without_a_law_are_missing() {
    for (lines, says) in [
        ("y = { categorical = [\"0 * action\", 0] }", "`y` is missing"),
        ("y = { uniform = [\"action\", -1] }", "`y` is missing"),
        ("y = { lognormal = [700, \"10 + action\"] }", "`y` is infinite"),
    ] {
        let environment = environment(&with_variables(lines), "", "");
        let declared: &DeclaredModel = environment.model().unwrap();
        let mut world = declared.simulation(&"all".parse().unwrap(), 1, 200);
        let mut draws = streams(200);
        world.reset(LaneSet::All, &mut draws);
        (0..5).for_each(|_| {
            world.step(&[Action::from_index(1).unwrap(); 200], &mut [0.0; 200], &mut draws)
        });
        let found = environment.failure().unwrap_or_else(|| panic!("{lines}"));
        assert!(found.contains(says), "{found}");
    }
}

#[test]
fn a_feature_that_a_person_lacks_stops_the_simulation() {
    let text = with_variables("y = \"age + action\"").replace("[\"step\"]", "[\"height\"]");
    let environment = environment(&text, "age,height\n3,\n4,1.8\n", "");
    let declared: &DeclaredModel = environment.model().unwrap();
    let mut world = declared.simulation(&"all".parse().unwrap(), 1, 2);
    world.assign(&[1, 0]);
    world.reset(LaneSet::All, &mut streams(2));
    let says = "model: feature `height` is missing for person 2 at decision 0";
    assert_eq!(environment.failure().unwrap(), says);
}

#[test]
fn a_missing_coefficient_is_named_where_its_block_is_used() {
    let text = format!(
        "{}[linear]\nbase = {{ prefix = \"b_\", features = [\"step\", \"1\"] }}\n",
        with_variables("y = { gaussian = [\"base + action\", 1] }")
    );
    let environment = environment(&text, "b_step,b_1\n0.5,\n", "");
    let declared: &DeclaredModel = environment.model().unwrap();
    let mut world = declared.simulation(&"all".parse().unwrap(), 1, 1);
    let mut draws = streams(1);
    world.reset(LaneSet::All, &mut draws);
    world.step(&[Action::default()], &mut [0.0], &mut draws);
    let says = environment.failure().unwrap();
    assert!(
        says.contains("`base` is missing") && says.contains("column b_1 of the people is empty"),
        "{says}"
    );
}

#[test]
fn rows_are_replayed_in_their_order() {
    let text = |order: &str| {
        format!(
            "format = 1\ndays = 6\n[replay]\norder = \"{order}\"\ncolumns = [\"load\"]\n[variables]\nlast = \"default(load[-1], -1)\"\n\
             y = \"default(load, 9) + last + action\"\n[roles]\noutcome = \"y\"\nstate = [\"last\"]\nfeatures = [\"last\"]\n"
        )
    };
    let rows = "person,load,other\nb,1,x\nb,2,\nb,,\na,5,\na,6,\na,7,\na,8,\n";
    let outcomes = |order: &str| {
        let mut world = world(&text(order), "person,height\na,1\nb,2\n", rows, 2);
        let mut draws = streams(2);
        world.assign(&[0, 1]);
        world.reset(LaneSet::All, &mut draws);
        let mut all = Vec::new();
        for _ in 0..6 {
            let mut rewards = [0.0; 2];
            world.step(&[Action::default(); 2], &mut rewards, &mut draws);
            all.push(rewards);
        }
        all
    };
    let own = [[4.0, 0.0], [11.0, 3.0], [13.0, 11.0], [15.0, 8.0], [17.0, 8.0], [8.0, 8.0]];
    assert_eq!(outcomes("own"), own);
    let cyclic = [[4.0, 0.0], [11.0, 3.0], [13.0, 11.0], [15.0, 0.0], [13.0, 3.0], [11.0, 11.0]];
    assert_eq!(outcomes("cyclic"), cyclic);
    let random = outcomes("random");
    assert!(random.iter().all(|[one, _]| (4.0..=16.0).contains(one)), "{random:?}");
}

#[test]
fn a_table_gives_its_values_with_their_probabilities() {
    let text = "format = 1\ndays = 400\n[tables]\nnext = \"\"\"\nstate,action,value,probability\n0,0,0,0.5\n0,0,1,0.5\n\
                0,1,2,1\n1,0,1,1\n1,1,0,1\n2,0,2,3\n2,0,0,1\n2,1,1,1\n\"\"\"\n[variables]\n\
                now = \"default(then[-1], 0)\"\nthen = { table = \"next\", given = [\"now\", \"action\"] }\n\
                y = \"then\"\n[roles]\noutcome = \"y\"\nfeatures = [\"now\"]\n";
    let mut world = world(text, "", "", 50);
    let mut draws = streams(50);
    world.reset(LaneSet::All, &mut draws);
    let (now, then) = (world.named("now"), world.named("then"));
    let mut counts = std::collections::BTreeMap::new();
    let mut rewards = vec![0.0; 50];
    for step in 0..400 {
        let action = Action::from_index(step % 2).unwrap();
        let before: Vec<f64> = (0..50).map(|lane| world.quantity(now, lane)).collect();
        world.step(&[action; 50], &mut rewards, &mut draws);
        for (lane, before) in before.iter().enumerate() {
            let key = (*before as u8, step % 2, world.quantity(then, lane) as u8);
            *counts.entry(key).or_insert(0u32) += 1;
        }
    }
    let count = |key| f64::from(counts.get(&key).copied().unwrap_or(0));
    for (certain, others) in [((0, 1, 2), [0, 1]), ((1, 0, 1), [0, 2]), ((1, 1, 0), [1, 2])] {
        let (state, action, _) = certain;
        assert!(
            count(certain) > 0.0
                && others.iter().all(|other| count((state, action, *other)) == 0.0)
        );
    }
    let share = count((2, 0, 2)) / (count((2, 0, 2)) + count((2, 0, 0)));
    assert!((share - 0.75).abs() < 0.03, "{share}");
}

#[test]
fn models_are_shared_by_copies() {
    let world = world(MANY, PEOPLE_OF_MANY, "", 2);
    let copy = world.with_lanes(7);
    assert_eq!(copy.lanes(), 7);
    let shared: &World = copy.downcast().unwrap();
    assert!(Arc::ptr_eq(world.parts(), shared.parts()));
}
