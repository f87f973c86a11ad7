//! The kinds of analyses: the keys of each, and the results from which each is computed.

use serde_json::{Value as Json, json};

use crate::job::metric::{LOWER_QUARTILE_RETURN, MEAN_RETURN, metrics_of};
use crate::job::{Condition, DataPart, MetricName, MetricPlace};
use crate::key::{FixedKind, Kind, Parameter, Value, choices};
use crate::manifest::analysis::axis::CurveAxis;
use crate::manifest::analysis::field::{AnalysisKey, AnalysisTable, Field, Fields, fields};
use crate::manifest::analysis::figure_keys::FigureKeys;
use crate::manifest::analysis::participants;
use crate::manifest::analysis::sides::Sides;
use crate::manifest::limits::MOST_JOBS;
use crate::manifest::parameter::seed_of;
use crate::manifest::text::fault::Fault;
use crate::manifest::text::source::Located;
use crate::manifest::text::written::{condition, list, quoted};
use crate::manifest::value::sweep::{Node, number, whole};

/// Declares the kinds: the word of each in manifests, the shared keys that it has, the keys of figures that it
/// follows, and its own keys.
macro_rules! kinds {
    ($(
        $(#[$attribute:meta])+
        $Kind:ident = $word:literal, [$($shared:ident),*], $figure:expr, { $($fields:tt)* }
    )+) => {
        $(
            fields! {
                $(#[$attribute])+
                pub struct $Kind { $($fields)* }
            }
        )+

        /// The kind of an analysis.
        #[derive(Clone, Debug, PartialEq)]
        pub enum AnalysisKind {
            $($(#[$attribute])+ $Kind($Kind),)+
        }

        /// Every kind, in the order of the documentation.
        pub(in crate::manifest) const KINDS: &[KindDeclaration] = &[$(
            KindDeclaration {
                word: $word,
                shared: &[NAME, TITLE, WHERE, $($shared),*],
                own: $Kind::keys,
                figure: &$figure,
                read: |table| $Kind::read(table).map(AnalysisKind::$Kind),
            },
        )+];

        impl AnalysisKind {
            /// The word of the kind in manifests.
            pub fn word(&self) -> &'static str {
                match self {
                    $(AnalysisKind::$Kind(_) => $word,)+
                }
            }

            /// The keys of the kind with their values, as a manifest writes them.
            pub(in crate::manifest) fn written(&self) -> Vec<(&'static str, String)> {
                match self {
                    $(AnalysisKind::$Kind(kind) => kind.written(),)+
                }
            }
        }
    };
}

/// Keys of figures that have a frame without axes of their own.
const FRAME: [&str; 5] = ["panel", "width", "height", "font_size", "theme"];
/// Keys of figures with lines along an axis.
const LINES: [&str; 8] =
    ["x_scale", "panel", "width", "height", "font_size", "y_min", "y_max", "theme"];

kinds! {
    /// Differences of means between two sides, at every setting of the other parameters.
    Contrast = "contrast", [METRIC, PARTICIPANTS], FRAME, {
        /// the two sides, first minus second
        sides: Sides;
        /// whether seeds are compared in pairs
        pairing: Pairing = Pairing::Automatic, in Pairing::KIND;
        /// the contrasts whose p values are corrected together; the name by default
        family: FamilyName;
    }

    /// A metric along a parameter, one line per agent and scenario.
    Curve = "curve", [METRIC, PARTICIPANTS], LINES, {
        /// the horizontal axis
        x: CurveAxis;
    }

    /// A moving mean of the return over training episodes.
    LearningCurve = "learning_curve", [], LINES, {
        /// training episodes in the moving mean
        window: u32 = 100, in Kind::Integer { min: 1, max: 10_000_000 };
    }

    /// A mean, or a difference of means, over two parameters; one map per agent.
    HeatMap = "heat_map", [METRIC, PARTICIPANTS], FRAME, {
        /// the horizontal axis
        x: Parameter;
        /// the vertical axis
        y: Parameter;
        /// the sides of a difference; without them, the mean itself is shown
        sides: Option<Sides>;
    }

    /// Shares of the actions chosen in the test, by bins of the probability of context 0.
    ActionChoice = "action_choice", [], FRAME, {
        /// bins of the context probability
        bins: Bins = Bins(5);
    }

    /// The hyper-parameters selected for each agent.
    Selection = "selection", [METRIC], [], {
        /// how settings are ranked
        rule: SelectionRule = SelectionRule::HighestMean, in SelectionRule::KIND;
        /// seeds for reporting the chosen settings; none may be a seed of this manifest
        reporting_seeds: Vec<u64>;
    }

    /// The share of the distance to the optimum that some arms recover relative to others.
    Recovery = "recovery", [], [], {
        /// the arms that recover part of the loss
        with: Vec<Condition>;
        /// the arms whose distance to the optimum is the loss
        without: Vec<Condition>;
    }

    /// How estimates behave over trials: bias, standard errors, coverage and power.
    OperatingCharacteristics = "operating_characteristics", [], LINES, {
        /// the names of the estimates; all by default
        estimates: EstimateNames;
        /// the horizontal axis of the figures; `trial.people` with `find`
        x: Option<Parameter>;
        /// the power whose number of people is sought along `trial.people`
        find: Option<Find>;
    }

    /// Whether what trials learn about the effect of a message in a state is more than chance.
    DidItLearn = "did_it_learn", [], LINES, {
        /// the states, each a list of the values of the scenario's features in their order
        states: States;
        /// the message: the number of an action above 0
        action: u32 = 1, in Kind::Integer { min: 1, max: 255 };
        /// the trials without the effect; by default those whose environment.no_effect_at is the state
        without: Option<Vec<Condition>>;
    }

    /// The rate at which the most likely context is wrong.
    InferenceError = "inference_error", [], ["width", "height", "font_size", "theme"], {}
}

/// The declaration of a kind.
pub(in crate::manifest) struct KindDeclaration {
    /// The word of the kind in manifests.
    pub word: &'static str,
    shared: &'static [AnalysisKey],
    own: fn() -> Vec<AnalysisKey>,
    figure: &'static [&'static str],
    /// Reads the keys of the kind; `None` if one is faulty, which is reported.
    pub read: fn(&mut AnalysisTable<'_, '_>) -> Option<AnalysisKind>,
}

impl KindDeclaration {
    /// All keys of the kind except `kind`.
    pub fn keys(&self) -> Vec<AnalysisKey> {
        let of_figure = FigureKeys::keys().into_iter();
        let of_figure = of_figure.filter(|key| self.figure.contains(&key.name));
        self.shared.iter().copied().chain((self.own)()).chain(of_figure).collect()
    }

    /// The names of all keys of the kind; `kind` comes second, after the name.
    pub fn key_names(&self) -> Vec<&'static str> {
        let mut names: Vec<&str> = self.keys().iter().map(|key| key.name).collect();
        names.insert(1, "kind");
        names
    }
}

/// The names of the keys that every kind has.
pub(in crate::manifest) const SHARED: [&str; 4] = [NAME.name, "kind", TITLE.name, WHERE.name];

const NAME: AnalysisKey = AnalysisKey {
    name: "name",
    doc: "the name in files and links",
    schema: || json!({ "$ref": "#/$defs/name" }),
};

const TITLE: AnalysisKey = AnalysisKey {
    name: "title",
    doc: "the heading in the report",
    schema: || json!({ "type": "string" }),
};

const WHERE: AnalysisKey = AnalysisKey {
    name: "where",
    doc: "the jobs to analyse; all by default",
    schema: || json!({ "$ref": "#/$defs/exclude" }),
};

const METRIC: AnalysisKey = AnalysisKey {
    name: "metric",
    doc: "the metric to analyse",
    schema: || {
        let words: Vec<_> = metrics_of(MetricPlace::Analyses).map(MetricName::text).collect();
        json!({
            "anyOf": [
                { "enum": words },
                { "type": "string", "pattern": "^mean_return_first_[1-9][0-9]*$" },
            ],
            "default": MEAN_RETURN.text(),
        })
    },
};

const PARTICIPANTS: AnalysisKey = AnalysisKey {
    name: "participants",
    doc: "the test episodes of participants between two quantiles of a parameter",
    schema: participants::schema,
};

choices! {
    /// How the seeds of two arms are compared.
    pub enum Pairing {
        /// Paired by seed if both sides were given the same seeds, and unpaired otherwise.
        Automatic = "automatic",
        /// As two independent samples.
        Unpaired = "unpaired",
        /// Paired by seed; a seed that one side lacks is left out.
        BySeed = "by_seed",
    }
}

choices! {
    /// How settings of hyper-parameters are ranked.
    pub enum SelectionRule {
        /// By the mean over seeds.
        HighestMean = "highest_mean",
        /// By the lower end of the 95 % interval of the mean over seeds.
        HighestLowerBound = "highest_lower_bound",
        /// By the mean over seeds, the lowest first.
        LowestMean = "lowest_mean",
    }
}

/// A family of contrasts whose p values are corrected together.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FamilyName(pub String);

impl Field for FamilyName {
    fn schema(_: Option<Kind>) -> Json {
        json!({ "$ref": "#/$defs/name" })
    }

    fn read(table: &mut AnalysisTable<'_, '_>, key: &str, _: Option<Kind>) -> Option<FamilyName> {
        Some(FamilyName(match table.node(key) {
            Some(node) => table.reader.name(key, node).value,
            None => table.name.to_owned(),
        }))
    }

    fn written(&self, key: &'static str) -> Vec<(&'static str, String)> {
        vec![(key, quoted(&self.0))]
    }
}

/// A number of bins into which the ten bins of the store can be merged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bins(pub u8);

impl Bins {
    const ALL: [u8; 4] = [1, 2, 5, 10];
}

impl Field for Bins {
    fn schema(_: Option<Kind>) -> Json {
        json!({ "enum": Bins::ALL })
    }

    fn read(table: &mut AnalysisTable<'_, '_>, key: &str, _: Option<Kind>) -> Option<Bins> {
        let node = table.node(key)?;
        let bins = whole(node).and_then(|bins| u8::try_from(bins).ok());
        let bins = bins.filter(|bins| Bins::ALL.contains(bins));
        if bins.is_none() {
            table.reader.expected(key, "1, 2, 5 or 10", node);
        }
        bins.map(Bins)
    }

    fn written(&self, key: &'static str) -> Vec<(&'static str, String)> {
        vec![(key, self.0.to_string())]
    }
}

/// Seeds on which selected settings are evaluated.
impl Field for Vec<u64> {
    fn schema(_: Option<Kind>) -> Json {
        json!({ "anyOf": [
            { "type": "integer", "minimum": 1, "maximum": MOST_JOBS },
            {
                "type": "array",
                "minItems": 1,
                "uniqueItems": true,
                "items": { "$ref": "#/$defs/seed" },
            },
        ] })
    }

    fn read(table: &mut AnalysisTable<'_, '_>, key: &str, _: Option<Kind>) -> Option<Vec<u64>> {
        let Some(node) = table.node(key) else {
            let message = format!("missing key `{key}` in an [[analysis]] of kind \"selection\"");
            let help = "list the seeds of the manifests that report the chosen settings; results on \
                        the seeds of the search are biased upwards";
            table.reader.faults.add(Fault::at(table.span, message).help(help));
            return None;
        };
        // A few characters can request millions of seeds, and a manifest can have a thousand analyses.
        let count = whole(node).map(|count| usize::try_from(count).unwrap_or(usize::MAX));
        let fits = count.is_none_or(|count| table.reader.count_in(key, count, node));
        let seeds = if fits { table.reader.seeds(key, node) } else { Vec::new() };
        Some(seeds.iter().map(seed_of).collect())
    }

    fn written(&self, key: &'static str) -> Vec<(&'static str, String)> {
        vec![(key, list(self))]
    }
}

/// Conditions on the arms of a recovery.
impl Field for Vec<Condition> {
    fn schema(_: Option<Kind>) -> Json {
        json!({ "$ref": "#/$defs/exclude" })
    }

    fn read(table: &mut AnalysisTable<'_, '_>, key: &str, _: Option<Kind>) -> Option<Self> {
        let Some(node) = table.node(key) else {
            table.missing(key, "write conditions: { agent.name = \"ppo\", scenario = \"P-T\" }");
            return None;
        };
        let keys = table.reader.table(key, node)?;
        if keys.is_empty() {
            let expected = "at least one condition, as in { agent.name = \"ppo\" }";
            table.reader.expected(key, expected, node);
        }
        let conditions = table.reader.conditions(keys, &format!("`{key}`"));
        let conditions: Vec<Condition> = conditions.into_iter().map(|one| one.value).collect();
        table.locate(node.span().into(), &conditions);
        (!conditions.is_empty()).then_some(conditions)
    }

    fn written(&self, key: &'static str) -> Vec<(&'static str, String)> {
        let written: Vec<String> = self.iter().map(condition).collect();
        vec![(key, format!("{{ {} }}", written.join(", ")))]
    }
}

/// The names of declared estimates; none for all of them.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct EstimateNames(pub Vec<String>);

impl Field for EstimateNames {
    fn schema(_: Option<Kind>) -> Json {
        json!({ "type": "array", "minItems": 1, "uniqueItems": true, "items": { "$ref": "#/$defs/name" } })
    }

    fn read(table: &mut AnalysisTable<'_, '_>, key: &str, _: Option<Kind>) -> Option<Self> {
        let Some(node) = table.node(key) else { return Some(EstimateNames::default()) };
        let items = table.reader.items(key, node);
        let names = items.into_iter().map(|item| table.reader.name(key, item).value);
        Some(EstimateNames(names.collect()))
    }

    fn written(&self, key: &'static str) -> Vec<(&'static str, String)> {
        let names: Vec<String> = self.0.iter().map(quoted).collect();
        if names.is_empty() { Vec::new() } else { vec![(key, format!("[{}]", names.join(", ")))] }
    }
}

/// States of which each is a list of the values of the features that an agent sees.
#[derive(Clone, Debug, PartialEq)]
pub struct States(pub Vec<Vec<f64>>);

impl Field for States {
    fn schema(_: Option<Kind>) -> Json {
        let state = json!({ "type": "array", "minItems": 1, "items": { "type": "number" } });
        json!({ "type": "array", "minItems": 1, "uniqueItems": true, "items": state })
    }

    fn read(table: &mut AnalysisTable<'_, '_>, key: &str, _: Option<Kind>) -> Option<States> {
        let Some(node) = table.node(key) else {
            table.missing(key, "list states: [[1, -0.7, -0.1, 0], [0, -0.7, -0.1, 0]]");
            return None;
        };
        let state = |node: &Node| {
            let items = node.get_ref().as_array().filter(|items| !items.is_empty())?;
            let numbers: Option<Vec<f64>> = items.iter().map(number).collect();
            numbers.filter(|numbers| numbers.iter().all(|number| number.is_finite()))
        };
        let items = node.get_ref().as_array().filter(|items| !items.is_empty());
        let states: Option<Vec<Vec<f64>>> = items.and_then(|all| all.iter().map(state).collect());
        if states.is_none() {
            let expected = "a list of states, each a list of numbers, as in [[1, -0.7, -0.1, 0]]";
            table.reader.expected(key, expected, node);
        }
        states.map(States)
    }

    fn written(&self, key: &'static str) -> Vec<(&'static str, String)> {
        let states: Vec<String> =
            self.0.iter().map(|state| Value::Reals(state.clone()).to_string()).collect();
        vec![(key, format!("[{}]", states.join(", ")))]
    }
}

/// What is sought along the number of people.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Find {
    /// The power, between 0 and 1.
    pub power: f64,
}

impl Field for Find {
    fn schema(_: Option<Kind>) -> Json {
        let power = json!({ "type": "number", "exclusiveMinimum": 0, "exclusiveMaximum": 1 });
        json!({
            "type": "object",
            "properties": { "power": power },
            "required": ["power"],
            "additionalProperties": false,
        })
    }

    fn read(table: &mut AnalysisTable<'_, '_>, key: &str, _: Option<Kind>) -> Option<Find> {
        let node = table.node(key)?;
        let power = node.get_ref().as_table().filter(|keys| keys.len() == 1);
        let power = power.and_then(|keys| keys.get("power")).and_then(number);
        let power = power.filter(|power| *power > 0.0 && *power < 1.0);
        if power.is_none() {
            table.reader.expected(key, "{ power = 0.8 } or another number between 0 and 1", node);
        }
        let value = Parameter::Trial("people");
        table.axes.push(Located { value, span: node.span().into() });
        power.map(|power| Find { power })
    }

    fn written(&self, key: &'static str) -> Vec<(&'static str, String)> {
        vec![(key, format!("{{ power = {} }}", Value::Real(self.power)))]
    }
}

impl AnalysisKind {
    /// The declaration of the kind.
    pub(in crate::manifest) fn declaration(&self) -> &'static KindDeclaration {
        let declared = KINDS.iter().find(|kind| kind.word == self.word());
        declared.expect("every kind is declared")
    }

    /// Whether the analysis shows the rate at which the most likely context is wrong.
    pub(in crate::manifest) fn shows_inference_error(&self) -> bool {
        matches!(
            self,
            AnalysisKind::InferenceError(_)
                | AnalysisKind::Curve(Curve { x: CurveAxis::ContextInferenceError })
        )
    }

    /// The part of the results that an analysis of this kind is computed from.
    pub(in crate::manifest) fn part(&self, metric: MetricName) -> DataPart {
        match self {
            AnalysisKind::LearningCurve(_) => DataPart::LearningCurve,
            AnalysisKind::ActionChoice(_) | AnalysisKind::InferenceError(_) => {
                DataPart::ActionChoice
            }
            AnalysisKind::OperatingCharacteristics(_) => DataPart::Estimates,
            AnalysisKind::DidItLearn(_) => DataPart::Posteriors,
            AnalysisKind::Contrast(_)
            | AnalysisKind::Curve(_)
            | AnalysisKind::HeatMap(_)
            | AnalysisKind::Recovery(_)
            | AnalysisKind::Selection(_) => match metric == LOWER_QUARTILE_RETURN {
                true => DataPart::Returns,
                false => DataPart::Metric(metric),
            },
        }
    }

    /// Seeds that the analysis needs in addition to the seeds of the manifest.
    pub(in crate::manifest) fn reporting_seeds(&self) -> &[u64] {
        if let AnalysisKind::Selection(selection) = self { &selection.reporting_seeds } else { &[] }
    }

    /// The sides of the difference; `None` if the analysis shows no difference.
    pub fn sides(&self) -> Option<&Sides> {
        match self {
            AnalysisKind::Contrast(contrast) => Some(&contrast.sides),
            AnalysisKind::HeatMap(map) => map.sides.as_ref(),
            AnalysisKind::Curve(_)
            | AnalysisKind::LearningCurve(_)
            | AnalysisKind::ActionChoice(_)
            | AnalysisKind::Selection(_)
            | AnalysisKind::Recovery(_)
            | AnalysisKind::OperatingCharacteristics(_)
            | AnalysisKind::DidItLearn(_)
            | AnalysisKind::InferenceError(_) => None,
        }
    }
}
impl DidItLearn {
    /// The fewest other trials without the effect that can give a p-value of 0.05: 2 / (1 + 39).
    pub const FEWEST: usize = 39;
}
