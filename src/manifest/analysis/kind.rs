//! The kinds of analyses: the keys of each, its checks, and the results from which each is computed.

use serde_json::json;

use crate::env::{Family, Scenario, recorded};
use crate::job::metric::{MEAN_RETURN, metrics_of};
use crate::job::{Condition, DataPart, MetricName, MetricPlace};
use crate::key::{FixedKind, Kind, Parameter, Value, choices};
use crate::manifest::analysis::axis::CurveAxis;
use crate::manifest::analysis::figure_keys::FigureKeys;
use crate::manifest::analysis::forms::{
    Bins, Diagnosands, FamilyName, Find, NameList, ParameterList, States,
};
use crate::manifest::analysis::participants;
use crate::manifest::analysis::sides::Sides;
use crate::manifest::table::{Fields, TableKey, TableReader, fields, name_key, names};
use crate::text::{Fault, FaultList, Span};

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

            /// What the kind needs beside its keys.
            pub(in crate::manifest) fn rules(&self) -> &dyn Rules {
                match self {
                    $(AnalysisKind::$Kind(kind) => kind,)+
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

/// What to write for missing conditions.
const CONDITIONS: &str = "write conditions: { agent.name = \"ppo\", scenario = \"P-T\" }";
/// What to write for a missing axis.
const SWEPT: &str = "write the dotted name of a swept parameter";

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
        x: Parameter, missing SWEPT;
        /// the vertical axis
        y: Parameter, missing SWEPT;
        /// the sides of a difference; without them, the mean itself is shown
        sides: Option<Sides>;
    }

    /// The days of single people: recorded variables over decisions, with the actions marked.
    Days = "days", [], ["width", "height", "font_size", "theme"], {
        /// names of the recorded state, and "reward"; the reward and the first seven by name by default
        variables: NameList;
        /// the people, numbered from 1 in the order of the test or trial, of the first seed of each arm
        people: Vec<u32> = vec![1], in Kind::Counts { most: 20, max: 10_000_000 };
    }

    /// Shares of the actions chosen in the test, by bins of the probability of context 0.
    ActionChoice = "action_choice", [], FRAME, {
        /// bins of the context probability
        bins: Bins = Bins(5);
    }

    /// The share of the distance to the optimum that some arms recover relative to others.
    Recovery = "recovery", [], [], {
        /// the arms that recover part of the loss
        with: Vec<Condition>, missing CONDITIONS;
        /// the arms whose distance to the optimum is the loss
        without: Vec<Condition>, missing CONDITIONS;
    }

    /// How estimates behave over trials: bias, standard errors, coverage and power.
    OperatingCharacteristics = "operating_characteristics", [], LINES, {
        /// the names of the estimates; all by default
        estimates: NameList;
        /// the horizontal axis of the figures; with `find`, that along which is sought
        x: Option<Parameter>;
        /// the power whose number of people is sought along `trial.people`, or whose smallest effect along the parameter
        /// `effect`
        find: Option<Find>;
        /// numbers of one's own: names, each with an expression of SQL over the rows of the view `estimate`
        diagnosands: Diagnosands;
    }

    /// Whether what trials learn about the effect of a message in a state is more than chance.
    DidItLearn = "did_it_learn", [], LINES, {
        /// the states, each a list of the values of the scenario's features in their order
        states: States;
        /// the message: the number of an action above 0
        action: u32 = 1, in Kind::Integer { min: 1, max: 255 };
        /// the trials without the effect
        without: Vec<Condition>, missing CONDITIONS;
        /// parameters whose values are the state for which a trial without the effect serves, in the order of the
        /// features; by default it serves for every state
        without_at: Option<ParameterList>;
    }

    /// How people differ in the effect of a message in a state, and what an agent with partial pooling knows of it.
    Shrinkage = "shrinkage", [], LINES, {
        /// the states, each a list of the values of the scenario's features in their order
        states: States;
        /// the message: the number of an action above 0
        action: u32 = 1, in Kind::Integer { min: 1, max: 255 };
    }

    /// Whether the actions of a recorded trial were drawn with the recorded probabilities; every report of one begins so.
    Randomisation = "randomisation", [], LINES, {}

    /// Estimates of single jobs with their intervals, beside published ones; every report of a recorded trial has them.
    Effects = "effects", [], [], {
        /// the names of the estimates; all by default
        estimates: NameList;
    }

    /// The probabilities that agents would have had at the decisions of a recorded trial, beside the recorded ones.
    Replay = "replay", [], LINES, {}

    /// The rate at which the most likely context is wrong.
    InferenceError = "inference_error", [], ["width", "height", "font_size", "theme"], {}
}

/// The declaration of a kind.
pub(in crate::manifest) struct KindDeclaration {
    /// The word of the kind in manifests.
    pub word: &'static str,
    shared: &'static [TableKey],
    own: fn() -> Vec<TableKey>,
    figure: &'static [&'static str],
    /// Reads the keys of the kind; `None` if one is faulty, which is reported.
    pub read: fn(&mut TableReader<'_, '_>) -> Option<AnalysisKind>,
}

impl KindDeclaration {
    /// All keys of the kind except `kind`.
    pub fn keys(&self) -> Vec<TableKey> {
        let of_figure = FigureKeys::keys().into_iter();
        let of_figure = of_figure.filter(|key| self.figure.contains(&key.name));
        self.shared.iter().copied().chain((self.own)()).chain(of_figure).collect()
    }

    /// The names of all keys of the kind; `kind` comes second, after the name.
    pub fn key_names(&self) -> Vec<&'static str> {
        let mut names = names(&self.keys());
        names.insert(1, "kind");
        names
    }
}

/// The names of the keys that every kind has.
pub(in crate::manifest) const SHARED: [&str; 4] = [NAME.name, "kind", TITLE.name, WHERE.name];

const NAME: TableKey = name_key("the name in files and links");

const TITLE: TableKey = TableKey {
    name: "title",
    doc: "the heading in the report",
    schema: || json!({ "type": "string" }),
    is_required: false,
};

const WHERE: TableKey = TableKey {
    name: "where",
    doc: "the jobs to analyse; all by default",
    schema: || json!({ "$ref": "#/$defs/exclude" }),
    is_required: false,
};

const METRIC: TableKey = TableKey {
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
    is_required: false,
};

const PARTICIPANTS: TableKey = TableKey {
    name: "participants",
    doc: "the test episodes of participants between two quantiles of a parameter",
    schema: participants::schema,
    is_required: false,
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

impl AnalysisKind {
    /// The declaration of the kind.
    pub(in crate::manifest) fn declaration(&self) -> &'static KindDeclaration {
        let declared = KINDS.iter().find(|kind| kind.word == self.word());
        declared.expect("every kind is declared")
    }

    /// The sides of the difference; `None` if the analysis shows no difference.
    pub fn sides(&self) -> Option<&Sides> {
        self.rules().sides()
    }
}

/// What an analysis of a kind needs of the results and of the rest of the manifest.
pub(in crate::manifest) trait Rules {
    /// The part of the results that it is computed from: by default the metric.
    fn part(&self, metric: MetricName) -> DataPart {
        match metric.quantile() {
            Some(_) => DataPart::Returns,
            None => DataPart::Metric(metric),
        }
    }

    /// What it needs that this family of environments lacks.
    fn lacking(&self, _: &Family) -> Option<&'static str> {
        None
    }

    /// Reports what the rest of the manifest does not declare.
    fn check(&self, _: &dyn Declares, _: Span, _: &mut FaultList) {}

    /// The conditions on the two groups of jobs of which each needs one, beside its own jobs.
    fn groups(&self) -> Option<[(&'static str, &[Condition]); 2]> {
        None
    }

    /// The sides of the difference; `None` if it shows no difference.
    fn sides(&self) -> Option<&Sides> {
        None
    }

    /// Whether it shows the rate at which the most likely context is wrong.
    fn shows_inference_error(&self) -> bool {
        false
    }
}

/// The rest of a manifest, as the checks of analyses see it.
pub(in crate::manifest) trait Declares {
    /// The values of a key of a section that agents share; `None` if the section lacks the key.
    fn values(&self, parameter: Parameter) -> Option<&[Value]>;

    /// Whether cells of the grid have these numbers of these parameters, which need not be of one cell unless a zip
    /// has them all.
    fn has_together(&self, parameters: &[Parameter], numbers: &[f64]) -> bool;

    /// The scenarios; empty if some are faulty.
    fn scenarios(&self) -> Vec<Scenario>;

    /// The names of the estimates that hold; `None` if the manifest has no table of one.
    fn estimates(&self) -> Option<Vec<&str>>;
}

/// What kinds lack that read a recorded trial.
fn recorded_of(family: &Family) -> Option<&'static str> {
    (family != &recorded::FAMILY).then_some("decisions of a trial that happened, with [data]")
}

/// The decisions of everybody.
const EVERYBODY: DataPart = DataPart::Days(10_000_000);

impl Rules for Randomisation {
    fn part(&self, _: MetricName) -> DataPart {
        EVERYBODY
    }

    fn lacking(&self, family: &Family) -> Option<&'static str> {
        recorded_of(family)
    }
}

impl Rules for Replay {
    fn part(&self, _: MetricName) -> DataPart {
        EVERYBODY
    }

    fn lacking(&self, family: &Family) -> Option<&'static str> {
        recorded_of(family)
    }
}

/// What kinds lack that show contexts.
fn contexts_of(family: &Family) -> Option<&'static str> {
    (!family.has_contexts).then_some("inferred contexts")
}

impl Rules for Contrast {
    fn sides(&self) -> Option<&Sides> {
        Some(&self.sides)
    }
}

impl Rules for Curve {
    fn lacking(&self, family: &Family) -> Option<&'static str> {
        let needs = self.shows_inference_error() && !family.has_contexts;
        needs.then_some("inferred contexts; give `x`, a swept parameter")
    }

    fn shows_inference_error(&self) -> bool {
        self.x == CurveAxis::ContextInferenceError
    }
}

impl Rules for Days {
    fn part(&self, _: MetricName) -> DataPart {
        DataPart::Days(self.people.last().copied().unwrap_or(1))
    }

    /// Reports decisions that are not recorded.
    fn check(&self, rest: &dyn Declares, span: Span, faults: &mut FaultList) {
        let recorded = rest.values(Parameter::Evaluation("record_decisions")).unwrap_or_default();
        let is_recorded = |value: &Value| !matches!(value, Value::Choice("none"));
        if !recorded.iter().any(is_recorded) {
            let fault = Fault::at(span, "kind \"days\" needs the decisions of the test or trial");
            faults.add(fault.help("write record_decisions = \"test\" in [evaluation]"));
        }
        let of_trial = rest.values(Parameter::Trial("people"));
        let people = of_trial.or_else(|| rest.values(Parameter::Evaluation("test_episodes")));
        let most = people.unwrap_or_default().iter().filter_map(|value| match value {
            Value::Integer(whole) => Some(*whole),
            _ => None,
        });
        if let (Some(person), Some(most)) = (self.people.last(), most.max())
            && u64::from(*person) > most
        {
            let says = format!("there is no person {person}: the test or trial has {most}");
            faults.add(Fault::at(span, says).help("people are numbered from 1"));
        }
    }
}

impl Rules for LearningCurve {
    fn part(&self, _: MetricName) -> DataPart {
        DataPart::LearningCurve
    }
}

impl Rules for HeatMap {
    fn sides(&self) -> Option<&Sides> {
        self.sides.as_ref()
    }
}

impl Rules for ActionChoice {
    fn part(&self, _: MetricName) -> DataPart {
        DataPart::ActionChoice
    }

    fn lacking(&self, family: &Family) -> Option<&'static str> {
        contexts_of(family)
    }
}

impl Rules for Recovery {
    fn lacking(&self, family: &Family) -> Option<&'static str> {
        (!family.has_optimum).then_some("an optimum")
    }

    fn groups(&self) -> Option<[(&'static str, &[Condition]); 2]> {
        Some([("with", &self.with), ("without", &self.without)])
    }
}

/// Reports estimates that a kind needs and that are not declared; false without any.
fn check_estimates(
    word: &str,
    names: &NameList,
    rest: &dyn Declares,
    span: Span,
    faults: &mut FaultList,
) -> bool {
    let Some(declared) = rest.estimates() else {
        let message = format!("kind \"{word}\" needs an [[estimate]]");
        faults.add(Fault::at(span, message).help("write [[estimate]] with name = \"effect\""));
        return false;
    };
    for name in names.0.iter().filter(|name| !declared.contains(&name.as_str())) {
        let fault = Fault::at(span, format!("no [[estimate]] is called `{name}`"));
        let fault = fault.help(format!("the estimates are {}", declared.join(", ")));
        faults.add(fault.nearest(name, declared.iter().copied()));
    }
    true
}

impl Rules for Effects {
    fn part(&self, _: MetricName) -> DataPart {
        DataPart::Estimates
    }

    fn check(&self, rest: &dyn Declares, span: Span, faults: &mut FaultList) {
        check_estimates("effects", &self.estimates, rest, span, faults);
    }
}

impl Rules for OperatingCharacteristics {
    fn part(&self, _: MetricName) -> DataPart {
        DataPart::Estimates
    }

    /// Reports estimates that are not declared, and people along another axis.
    fn check(&self, rest: &dyn Declares, span: Span, faults: &mut FaultList) {
        if !check_estimates("operating_characteristics", &self.estimates, rest, span, faults) {
            return;
        }
        if let (Some(find), Some(x)) = (self.find, self.x)
            && find.along() != x
        {
            let message = format!("`find` is sought along `{}`, and `x` is `{x}`", find.along());
            let help = "leave out `x`, or seek it in another analysis";
            faults.add(Fault::at(span, message).help(help));
        }
    }
}

impl DidItLearn {
    /// The fewest other trials without the effect that can give a p-value of 0.05: 2 / (1 + 39).
    pub const FEWEST: usize = 39;

    /// The parameters whose values are the state for which a trial without the effect serves; none if it serves for
    /// every state.
    pub fn without_at(&self) -> impl Iterator<Item = &Parameter> {
        self.without_at.iter().flat_map(|list| &list.0)
    }
}

impl Rules for DidItLearn {
    fn part(&self, _: MetricName) -> DataPart {
        DataPart::Posteriors
    }

    /// Reports states of which no trial without an effect is declared or that agents do not see, and posteriors that
    /// are not recorded.
    fn check(&self, rest: &dyn Declares, span: Span, faults: &mut FaultList) {
        check_recorded("did_it_learn", rest, span, faults);
        let mut fault = |says: String, help: &str| faults.add(Fault::at(span, says).help(help));
        let at = self.without_at.as_ref().map_or(&[][..], |list| &list.0);
        for state in &self.states.0 {
            let shown = Value::Reals(state.clone());
            if let Some(says) = unseen(state, rest) {
                fault(says, SEEN);
            } else if !at.is_empty() && at.len() != state.len() {
                let says = format!(
                    "`without_at` has {} parameters, and the state {shown} {} numbers",
                    at.len(),
                    state.len()
                );
                fault(says, "name one parameter per feature of the scenario, in their order");
            } else if !at.is_empty() && !rest.has_together(at, state) {
                let says =
                    format!("no trial has the state {shown} in the parameters of `without_at`");
                fault(
                    says,
                    "write its values in [environment.parameters], zipped with what removes the effect",
                );
            }
        }
    }
}

/// Reports posteriors that a kind needs and that are not recorded.
fn check_recorded(word: &str, rest: &dyn Declares, span: Span, faults: &mut FaultList) {
    let is_recorded = rest.values(Parameter::Evaluation("record_posteriors"));
    if !is_recorded.is_some_and(|all| all.contains(&Value::Flag(true))) {
        let says = format!("kind \"{word}\" needs the posteriors at the updates of a trial");
        faults.add(Fault::at(span, says).help("write record_posteriors = true in [evaluation]"));
    }
}

/// What to do where agents do not see a state.
const SEEN: &str = "a state has the values of the features of the scenario, in order";

/// Why agents do not see a state; `None` if they do.
fn unseen(state: &[f64], rest: &dyn Declares) -> Option<String> {
    let is_seen =
        |scenario: &Scenario| scenario.names().is_none_or(|names| names.count() == state.len());
    let shown = Value::Reals(state.to_vec());
    (!rest.scenarios().iter().all(is_seen))
        .then(|| format!("the state {shown} does not have a value for each feature"))
}

impl Rules for Shrinkage {
    fn part(&self, _: MetricName) -> DataPart {
        DataPart::PersonPosteriors
    }

    /// Reports states that agents do not see, trials without partial pooling, and posteriors that are not recorded.
    fn check(&self, rest: &dyn Declares, span: Span, faults: &mut FaultList) {
        check_recorded("shrinkage", rest, span, faults);
        for says in self.states.0.iter().filter_map(|state| unseen(state, rest)) {
            faults.add(Fault::at(span, says).help(SEEN));
        }
        let poolings = rest.values(Parameter::Trial("pooling"));
        if !poolings.is_some_and(|all| all.contains(&Value::Choice("partial"))) {
            let says = "kind \"shrinkage\" needs an agent with partial pooling";
            faults.add(Fault::at(span, says).help("write pooling = \"partial\" in [trial]"));
        }
    }
}

impl Rules for InferenceError {
    fn part(&self, _: MetricName) -> DataPart {
        DataPart::ActionChoice
    }

    fn lacking(&self, family: &Family) -> Option<&'static str> {
        contexts_of(family)
    }

    fn shows_inference_error(&self) -> bool {
        true
    }
}
