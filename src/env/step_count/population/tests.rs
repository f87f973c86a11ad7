use super::*;
use crate::env::{
    Action, ContextDraw, EpisodeStatus, LaneSet, LaneStreams, PhysicalActivity, VectorEnvironment,
};
use crate::rng::Purpose;

fn normal(mean: f64, sd: f64) -> Distribution {
    Distribution::Normal { mean, sd, bounds: [0.0, 1.0] }
}

fn people() -> Population {
    Population {
        delta_d: Distribution::LogNormal { median: 0.1, log_sd: 0.5, bounds: [0.0, 1.0] },
        initial_disengagement: normal(0.2, 0.1),
        mu: Distribution::Uniform([0.0, 2.0]),
        mu_1: Distribution::Values { values: vec![5.0, 6.0], weights: vec![1.0, 3.0] },
        ..Population::default()
    }
}

fn drawn(population: &Population, stream: &mut Stream, count: usize) -> Vec<Vec<f64>> {
    let sampler = ParticipantSampler::new(population);
    (0..count).map(|_| sampler.participant(stream)).collect()
}

#[test]
fn every_parameter_reaches_its_field() {
    for (index, column) in COLUMNS.iter().enumerate() {
        let mut values = Population::default().to_values();
        let key = Population::KEYS.iter().position(|key| key.name == column.name).unwrap();
        // A value within the range of every parameter that equals no default.
        values[key] = crate::key::Value::Distribution(Distribution::Constant(0.625));
        let population = Population::from_values(&values).unwrap();
        assert_eq!(population.names().collect::<Vec<_>>(), [column.name]);
        let mut person = StepCount::paper(0.6);
        SETTERS[index](&mut person, 0.625);
        let changed: Vec<String> = StepCount::paper(0.6)
            .to_json()
            .into_iter()
            .filter(|(name, value)| person.to_json()[name] != *value)
            .map(|(name, value)| format!("{name} {value} {}", person.to_json()[&name]))
            .collect();
        let [changed] = &changed[..] else { panic!("{}: {changed:?}", column.name) };
        let named = column.name.trim_end_matches("_0").trim_end_matches("_1");
        let expected = if column.name.starts_with("mu") { "mu" } else { column.name };
        assert!(changed.starts_with(expected) && changed.contains("0.625"), "{named}: {changed}");
        // The range is the same as in the environment.
        let of_environment = StepCount::KEYS.iter().find(|key| key.name == column.name);
        let kind = of_environment.map(|key| key.kind);
        let stricter = matches!(column.name, "kappa_h" | "kappa_d" | "sigma_s");
        assert!(
            stricter
                || column.name.starts_with("mu")
                || kind.map(Kind::number_range) == Some(column.of),
            "{}",
            column.name
        );
    }
    let real = |key: &&crate::key::Key| {
        matches!(key.kind, Kind::Real { .. } | Kind::PositiveReal { .. } | Kind::RealPair { .. })
    };
    for key in StepCount::KEYS.iter().filter(real) {
        assert!(COLUMNS.iter().any(|column| column.name == key.name), "{}", key.name);
    }
    assert!(COLUMNS.len() < crate::rng::PARTICIPANT_WORDS);
}

#[test]
fn draws_have_the_distributions_that_were_asked_for() {
    let count = 100_000;
    let mut stream = Stream::new(3, Purpose::Environment);
    let sampler = ParticipantSampler::new(&people());
    let all: Vec<&str> = ParticipantSampler::all_names().collect();
    let names: Vec<&str> = sampler.indices().iter().map(|index| all[*index]).collect();
    assert_eq!(names, ["delta_d", "mu", "mu_1", "initial_disengagement"]);
    let rows = drawn(&people(), &mut stream, count);
    for (column, name) in names.iter().enumerate() {
        let mut values: Vec<f64> = rows.iter().map(|row| row[column]).collect();
        values.sort_by(f64::total_cmp);
        let index = COLUMNS.iter().position(|known| known.name == *name).unwrap();
        for share in [0.05, 0.3, 0.5, 0.9] {
            let expected = people().distributions()[index].quantile(share).unwrap();
            let below = values.partition_point(|value| *value < expected) as f64 / count as f64;
            let upto = values.partition_point(|value| *value <= expected) as f64 / count as f64;
            // Four standard errors of a proportion.
            let error = 4.0 * (share * (1.0 - share) / count as f64).sqrt();
            assert!(
                below - error < share && share < upto + error,
                "{name} {share}: {below} {upto}"
            );
        }
    }
    // Parameters are independent of each other: rank correlations are near 0.
    let high = |row: &Vec<f64>, column: usize, median: f64| row[column] > median;
    let both = rows.iter().filter(|row| high(row, 0, 0.1) && high(row, 1, 1.0)).count();
    assert!((both as f64 / count as f64 - 0.25).abs() < 4.0 * (0.1875 / count as f64).sqrt());
}

#[test]
fn another_distribution_of_one_parameter_moves_no_other() {
    let stream = || Stream::new(3, Purpose::Environment);
    let before = drawn(&people(), &mut stream(), 50);
    let other = Population { mu: Distribution::Constant(1.0), rho_1: normal(0.5, 1.0), ..people() };
    let after = drawn(&other, &mut stream(), 50);
    for (one, two) in before.iter().zip(&after) {
        let [delta_d, _, mu_1, initial] = one[..] else { panic!("four parameters") };
        let [same, _, _, same_mu, same_initial] = two[..] else { panic!("five parameters") };
        assert_eq!([delta_d, mu_1, initial], [same, same_mu, same_initial]);
    }
}

#[test]
fn rows_keep_their_parameters_together() {
    let csv = "delta_d,epsilon_d,weight\n0.1,0.4,1\n0.2,0.8,3\n";
    let rows = Rows::from_csv(COLUMNS, csv).unwrap();
    let population =
        Population { rows, rho_1: Distribution::Uniform([0.0, 1.0]), ..Population::default() };
    let drawn = drawn(&population, &mut Stream::new(1, Purpose::TestEnvironment), 20_000);
    assert!(drawn.iter().all(|row| row[1] == 4.0 * row[0] && (0.0..1.0).contains(&row[2])));
    let first = drawn.iter().filter(|row| row[0] == 0.1).count() as f64 / 20_000.0;
    assert!((first - 0.25).abs() < 4.0 * (0.1875f64 / 20_000.0).sqrt(), "{first}");
    assert_eq!(population.given_twice(), None);
    let twice = Population { delta_d: normal(0.1, 0.1), ..population };
    assert_eq!(twice.given_twice(), Some("delta_d"));
}

#[test]
fn episodes_are_of_the_same_people_whatever_is_done() {
    let (environment, scenario) = (StepCount::paper(0.6), "C-H-D".parse().unwrap());
    let play = |lanes: usize, action: usize| {
        let mut simulation =
            PhysicalActivity::new(&environment, &scenario, lanes).with_population(&people());
        let mut streams = LaneStreams::Shared(Stream::new(5, Purpose::Environment));
        let mut met: Vec<Vec<f64>> = Vec::new();
        let (actions, mut rewards) =
            (vec![Action::from_index(action).unwrap(); lanes], vec![0.0; lanes]);
        while met.len() < 24 {
            simulation.reset(LaneSet::All, &mut streams);
            for lane in 0..lanes {
                let person = simulation.person(lane);
                let values =
                    simulation.participant(lane).map(|(_, value)| value).collect::<Vec<_>>();
                assert_eq!(
                    values,
                    [person.delta_d, person.mu[0], person.mu[1], person.initial_disengagement]
                );
                assert_eq!(simulation.disengagement()[lane], person.initial_disengagement);
                met.push(values);
            }
            while simulation.any_running() {
                simulation.step(&actions, &mut rewards, &mut streams);
            }
        }
        met
    };
    let met = play(1, 0);
    assert!(met.iter().zip(&met[1..]).all(|(one, next)| one != next));
    for (lanes, action) in [(1, 3), (4, 2), (24, 1)] {
        assert_eq!(play(lanes, action), met, "{lanes} lanes, action {action}");
    }
}

#[test]
fn everybody_like_the_environment_is_the_simulation_without_a_population() {
    let scenario = "C-P-L-H-D-A-S".parse().unwrap();
    let mut plain = StepCount::paper(0.6);
    plain.availability = 0.8;
    plain.message_cost = 2.0;
    for environment in [StepCount::paper(0.6), plain] {
        let constant = |x: f64| Distribution::Constant(x);
        let same = Population {
            sigma: constant(environment.sigma),
            delta_d: constant(environment.delta_d),
            rho_2: constant(environment.rho_2),
            availability: constant(environment.availability),
            message_cost: constant(environment.message_cost),
            ..Population::default()
        };
        for lanes in [1, 20] {
            let alike = PhysicalActivity::new(&environment, &scenario, lanes);
            let mut both = [alike.clone(), alike.with_population(&same)];
            let stream = || LaneStreams::Shared(Stream::new(5, Purpose::Environment));
            let mut streams = [stream(), stream()];
            let mut seen = [(); 2].map(|()| alike.observation_spec().observations());
            let mut rewards = [vec![0.0; lanes], vec![0.0; lanes]];
            for step in 0..200 {
                for i in 0..2 {
                    let ended: Vec<bool> =
                        both[i].statuses().iter().map(|s| *s != EpisodeStatus::Running).collect();
                    both[i].reset(LaneSet::Masked(&ended), &mut streams[i]);
                    let action = Action::from_index(step % 4).unwrap();
                    both[i].step(&vec![action; lanes], &mut rewards[i], &mut streams[i]);
                    both[i].observe(&mut seen[i]);
                }
                assert_eq!(rewards[0], rewards[1], "{lanes} lanes, step {step}");
                assert!((0..lanes).all(|lane| seen[0].row(lane) == seen[1].row(lane)));
            }
        }
    }
}

#[test]
fn the_parameters_of_contexts_and_steps_are_those_of_each_lane() {
    let constant =
        |values: [f64; 2]| Distribution::Values { values: values.into(), weights: vec![] };
    let population = Population {
        sigma: constant([0.0, 2.0]),
        context_probability: constant([0.1, 0.9]),
        availability: constant([0.25, 0.75]),
        rho_1: constant([10.0, 20.0]),
        ..Population::default()
    };
    let lanes = 4000;
    let mut simulation =
        PhysicalActivity::new(&StepCount::paper(0.6), &"C-P-A".parse().unwrap(), lanes)
            .with_population(&population);
    let mut streams = LaneStreams::Shared(Stream::new(8, Purpose::Environment));
    simulation.reset(LaneSet::All, &mut streams);
    let mut rewards = vec![0.0; lanes];
    simulation.step(&vec![Action::UNTAILORED; lanes], &mut rewards, &mut streams);
    let mut counts = [[0.0f64; 2]; 2];
    let mut free = [[0.0f64; 2]; 2];
    for lane in 0..lanes {
        let person = simulation.person(lane).clone();
        let ContextDraw { context, probability_of_zero: zero, .. } = simulation.context(lane);
        assert_eq!(person.sigma == 0.0, zero == 1.0 - f64::from(context), "{zero}");
        counts[usize::from(person.context_probability > 0.5)][usize::from(context)] += 1.0;
        free[usize::from(person.availability > 0.5)][usize::from(simulation.is_available(lane))] +=
            1.0;
        let sent = 0.1 + (1.0 - 0.15) * person.rho_1;
        let rested = person.mu[0];
        assert!(rewards[lane] == sent || rewards[lane] == rested, "{} {sent}", rewards[lane]);
    }
    for (table, shares) in [(counts, [0.1, 0.9]), (free, [0.25, 0.75])] {
        for ([no, yes], share) in table.into_iter().zip(shares) {
            let error = (share * (1.0 - share) / (no + yes)).sqrt();
            assert!((yes / (no + yes) - share).abs() < 4.0 * error, "{no} {yes}");
        }
    }
}
