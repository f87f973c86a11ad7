//! A condition has the same meaning in memory and in SQL.

use std::ops::ControlFlow;

use jitai::job::metric::MEAN_RETURN;
use jitai::job::{Condition, DataPart, Outcome, Results, Scalar};
use jitai::key::{Parameter, Value};
use jitai::manifest::{self, Manifest};
use jitai::plan;
use jitai::rng::{Purpose, Stream};
use jitai::store::{self, Answer, DataQuery, Parts, Reader};

use super::sample::{Sample, completed, experiment};

/// A manifest whose agents have different keys, with values of every type.
const MANIFEST: &str = r#"
format = 1
name = "sweep"
scenarios = ["P-H-D", "C"]
seeds = [1, 9007199254740993]
[environment]
sigma = [0.4, 1e-7, 2]
mu = [[0.1, 0.1], [0, 1e-7]]
time_one_hot = [true, false]
first_context = ["fixed", "sampled"]
[[agent]]
name = "dqn's"
algorithm = "dueling_dqn"
layers = [[8], [8, 16]]
[[agent]]
name = "reinforce"
algorithm = "reinforce"
[[agent]]
name = "never"
algorithm = "rule"
rule = "never"
"#;

/// The agent, the scenario, the seed and the values of some keys of each job, in order.
type Rows = Vec<(String, String, i64, Vec<Option<String>>)>;

fn in_memory(query: &DataQuery, data: &jitai::record::DataSet) -> Rows {
    let jobs = query.among(&data.jobs).into_iter();
    let row = |job: &jitai::record::JobRecord| {
        let keys = query.columns.iter();
        let keys = keys.map(|name| job.setting(name).map(Scalar::to_string)).collect();
        (job.agent.to_string(), job.scenario.clone(), job.seed as i64, keys)
    };
    let mut rows: Rows = jobs.map(row).collect();
    rows.sort();
    rows
}

fn in_sql(query: &DataQuery, reader: &Reader) -> Rows {
    let text = |value: &store::SqlValue<'_>| match value {
        store::SqlValue::Null => None,
        store::SqlValue::Integer(whole) => Some(Scalar::Real(*whole as f64).to_string()),
        store::SqlValue::Real(real) => Some(Scalar::Real(*real).to_string()),
        store::SqlValue::Text(text) => Some((*text).to_owned()),
        store::SqlValue::Blob(_) => panic!("no parameter is a blob"),
    };
    let mut rows = Vec::new();
    let sql = query.sql();
    let hear = |answer: Answer<'_>| {
        if let Answer::Row(values) = answer {
            let [agent, scenario, store::SqlValue::Integer(seed), keys @ .., _] = values else {
                panic!("{values:?}");
            };
            let [agent, scenario] = [agent, scenario].map(|word| text(word).unwrap());
            rows.push((agent, scenario, *seed, keys.iter().map(text).collect()));
        }
        ControlFlow::Continue(())
    };
    reader.query(&sql, hear).unwrap_or_else(|error| panic!("{error}\n{sql}"));
    rows.sort();
    rows
}

/// A condition on each value that the manifest's jobs have, and on some values that no job has.
fn conditions(manifest: &Manifest) -> Vec<Condition> {
    let scenarios = manifest.scenarios().chain(["L-H-D".parse().unwrap()]);
    let mut conditions: Vec<Condition> =
        scenarios.map(|one| Condition::texts(Parameter::SCENARIO, [one])).collect();
    let seeds = manifest.seeds().chain([9_007_199_254_740_992]).map(Value::Integer);
    let of_seed = |seed| Condition { parameter: Parameter::SEED, values: vec![seed] };
    conditions.extend(seeds.map(of_seed));
    let agents = manifest.agents.iter().map(|agent| agent.name.as_str());
    let names = agents.chain(["' OR 1"]);
    conditions.extend(names.map(|one| Condition::texts(Parameter::AGENT_NAME, [one])));
    let of_agents = manifest.agents.iter().map(|agent| &agent.parameters);
    let shared = manifest.sections.iter().map(|(_, parameters)| parameters);
    for parameters in shared.chain(of_agents) {
        for (key, values) in parameters.iter() {
            let dotted = format!("{}.{}", parameters.section().name(), key.name);
            let parameter = manifest::parameter(&dotted).unwrap();
            let condition = |value: &Value| Condition { parameter, values: vec![value.clone()] };
            conditions.extend(values.iter().chain([&Value::Real(0.123)]).map(condition));
        }
    }
    conditions
}

#[test]
fn a_condition_selects_the_same_jobs_in_memory_and_in_sql() {
    let manifest = manifest::parse("sweep", MANIFEST.as_bytes()).unwrap();
    let mut sample = Sample::new();
    let jobs = || plan::jobs(&manifest);
    let named = jobs().map(|planned| (planned.agent, planned.job));
    sample.store.register(&experiment("sweep"), named).unwrap();
    for (index, planned) in jobs().enumerate() {
        let Outcome::Completed(results) = completed() else { panic!("it completes") };
        let weights = results.weights.clone().filter(|_| planned.job.agent.episodes() > 0);
        // Some jobs stay without a run.
        if index % 5 != 0 {
            sample.run(&planned.job, &Outcome::Completed(Results { weights, ..results }));
        }
    }
    let reader = Reader::open(&sample.path).unwrap();
    let mut data = reader.data_set_of("sweep", jobs(), |_| Parts::default(), |_| ()).unwrap();
    data.jobs.retain(|job| job.completed().is_some());
    let all = conditions(&manifest);
    let columns = ["environment.sigma", "environment.mu", "agent.layers", "agent.algorithm"];
    let query = |conditions: Vec<Condition>| DataQuery {
        experiment: "sweep".to_owned(),
        conditions,
        columns: columns.map(str::to_owned).to_vec(),
        part: DataPart::Metric(MEAN_RETURN),
    };
    let mut sizes = std::collections::BTreeSet::new();
    let mut agree = |conditions: Vec<Condition>| {
        let query = query(conditions);
        let rows = in_memory(&query, &data);
        assert_eq!(rows, in_sql(&query, &reader), "{}", query.sql());
        sizes.insert(rows.len());
    };
    all.iter().for_each(|condition| agree(vec![condition.clone()]));
    let mut stream = Stream::new(1, Purpose::Bootstrap);
    for _ in 0..200 {
        let mut draw = || all[(stream.unit() * all.len() as f64) as usize].clone();
        let (first, second) = (draw(), draw());
        match first.or(&second) {
            Some(either) => agree(vec![either]),
            None => agree(vec![first, second]),
        }
    }
    assert!(sizes.len() > 10 && sizes.contains(&0), "the conditions select many sets: {sizes:?}");
}
