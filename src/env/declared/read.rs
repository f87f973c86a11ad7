//! Reads a model file: its tables and keys, as far as their form is right.

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use crate::env::declared::distribution::{DrawLaw, FORMS, Form};
use crate::env::declared::draft::{CoefficientBlock, DraftFeature, DraftRoles, ModelDraft};
use crate::env::declared::expression::{Expression, OPERATORS};
use crate::env::declared::grammar;
use crate::env::declared::model::{
    Clock, Definition, MOST_DAYS, ModelFile, ModelParameter, Moment, NamedExpression, PeopleDraw,
    ProbabilityTable, Quantity, ReplayOrder, TextPosition,
};
use crate::env::declared::{missing, resolve};
use crate::key::read_csv;
use crate::text::{Document, Fault, FaultList, Source, Span, document, hidden, nearest, shortened};

pub(super) type TomlNode<'t> = Spanned<DeValue<'t>>;

/// The format of model files.
const FORMAT: i64 = 1;
/// Maximum numbers of variables and parameters, and of decisions per day.
const MOST_VARIABLES: usize = 1000;
const MOST_PARAMETERS: usize = 100;
const MOST_DECISIONS_PER_DAY: i64 = 1440;

pub(super) const KEYS: [&str; 14] = [
    "format",
    "title",
    "unit",
    "actions",
    "decisions_per_day",
    "days",
    "parameters",
    "people",
    "person",
    "replay",
    "linear",
    "tables",
    "variables",
    "roles",
];

/// Reads a model.
///
/// **Errors**: every fault of the file, with positions.
pub(super) fn read(text: &str) -> Result<ModelFile, FaultList> {
    let Document { root, repeats, syntax, broken_at } = document(text);
    let mut reader = ModelReader::new(text);
    let draft = reader.draft(root.get_ref());
    let mut faults = reader.faults;
    faults.append(repeats);
    if !syntax.is_empty() {
        faults.retain_off_lines_of(&syntax, &Source::new(text));
        faults.retain_before(broken_at);
        faults.append(syntax);
        return Err(faults);
    }
    // Names are resolved even if the form is faulty, so that all faults are reported at once.
    let model = resolve::resolve(draft, &mut faults);
    if faults.is_empty() {
        missing::check(&model, &mut faults);
    }
    if faults.is_empty() { Ok(model) } else { Err(faults) }
}

pub(super) struct ModelReader<'t> {
    text: &'t str,
    pub faults: FaultList,
    tables: Vec<(String, ProbabilityTable, usize)>,
}

pub(super) fn span(node: &TomlNode<'_>) -> Span {
    node.span().into()
}

impl<'t> ModelReader<'t> {
    /// A reader of parts of a text.
    pub fn new(text: &'t str) -> ModelReader<'t> {
        ModelReader { text, faults: FaultList::default(), tables: Vec::new() }
    }

    pub fn fault(&mut self, span: Span, says: impl Into<String>) {
        self.faults.add(Fault::at(span, says));
    }

    pub fn expected(&mut self, name: &str, expected: &str, node: &TomlNode<'_>) {
        let found = self.text.get(node.span()).unwrap_or_default();
        let found = shortened(found.lines().next().unwrap_or_default());
        self.fault(span(node), format!("`{name}`: expected {expected}, found {found}"));
    }

    pub fn only_keys(&mut self, owner: &str, keys: &[&str], table: &DeTable<'_>) {
        for (key, _) in table {
            let found = key.get_ref().as_ref();
            if !keys.contains(&found) {
                let fault = Fault::at(
                    key.span().into(),
                    format!("{owner} has no key `{}`", shortened(found)),
                );
                self.faults.add(fault.one_of(owner, keys, found));
            }
        }
    }

    /// The entries of a table by their positions, or a fault.
    fn entries<'n>(
        &mut self,
        name: &str,
        root: &'n DeTable<'t>,
    ) -> Vec<(&'n str, Span, &'n TomlNode<'t>)> {
        let Some(node) = root.get(name) else { return Vec::new() };
        let Some(table) = node.get_ref().as_table() else {
            self.expected(name, "a table", node);
            return Vec::new();
        };
        sorted(table)
    }

    fn draft(&mut self, root: &DeTable<'t>) -> ModelDraft {
        // The section [fit] is read by a fit alone.
        let known: Vec<&str> = KEYS.into_iter().chain(["fit"]).collect();
        self.only_keys("a model", &known, root);
        let mut draft = ModelDraft::default();
        match root.get("format") {
            Some(node) if self.whole("format", (1, i64::MAX), node) == Some(FORMAT) => {}
            Some(node) => self.expected("format", "1", node),
            None => self.faults.add(Fault::whole("`format` is missing: it is 1")),
        }
        let model = &mut draft.model;
        model.title = self.words("title", root).unwrap_or_default();
        model.unit = self.words("unit", root);
        model.actions = self.actions(root);
        model.decisions_per_day = match root.get("decisions_per_day") {
            Some(node) => self
                .whole("decisions_per_day", (1, MOST_DECISIONS_PER_DAY), node)
                .unwrap_or(1) as u32,
            None => 1,
        };
        model.days = match root.get("days") {
            Some(node) => self.whole("days", (1, MOST_DAYS), node).unwrap_or(1) as u32,
            None => {
                let fault = Fault::whole("`days` is missing: the number of days of a person");
                self.faults.add(fault);
                1
            }
        };
        for (name, at, node) in self.entries("parameters", root) {
            if model.parameters.len() == MOST_PARAMETERS {
                self.fault(at, format!("a model has at most {MOST_PARAMETERS} parameters"));
                break;
            }
            self.check_name("a parameter", name, at);
            let default = self.number(name, node).unwrap_or(1.0);
            model.parameters.push(ModelParameter { name: name.to_owned(), default, span: at });
        }
        self.people(root, model);
        self.read_tables(root);
        self.quantities(root, &mut draft);
        self.blocks(root, &mut draft);
        draft.roles = self.roles(root);
        draft
    }

    fn words(&mut self, name: &str, root: &DeTable<'t>) -> Option<String> {
        let node = root.get(name)?;
        match node.get_ref() {
            DeValue::String(text) if is_short(text) => Some(text.to_string()),
            _ => {
                self.expected(
                    name,
                    "a text of at most 200 characters, without control characters",
                    node,
                );
                None
            }
        }
    }

    fn whole(&mut self, name: &str, (least, most): (i64, i64), node: &TomlNode<'t>) -> Option<i64> {
        let whole = match node.get_ref() {
            DeValue::Integer(integer) => {
                i64::from_str_radix(integer.as_str(), integer.radix()).ok()
            }
            _ => None,
        };
        let admitted = whole.filter(|whole| (least..=most).contains(whole));
        if admitted.is_none() && most < i64::MAX {
            self.expected(name, &format!("a whole number from {least} to {most}"), node);
        }
        admitted
    }

    pub fn number(&mut self, name: &str, node: &TomlNode<'t>) -> Option<f64> {
        let number = written_number(node);
        if number.is_none() {
            self.expected(name, "a number", node);
        }
        number
    }

    fn actions(&mut self, root: &DeTable<'t>) -> Vec<String> {
        let usual = || vec!["nothing".to_owned(), "a message".to_owned()];
        let Some(node) = root.get("actions") else { return usual() };
        let names: Option<Vec<String>> = node.get_ref().as_array().and_then(|items| {
            let short = |text: &&str| is_short(text);
            items
                .iter()
                .map(|item| item.get_ref().as_str().filter(short).map(str::to_owned))
                .collect()
        });
        match names {
            Some(names) if (2..=256).contains(&names.len()) => names,
            _ => {
                let expected = "a list of 2 to 256 texts, as in [\"nothing\", \"prompt\"]";
                self.expected("actions", expected, node);
                usual()
            }
        }
    }

    /// Reads one of several words.
    fn word<T: Copy>(&mut self, name: &str, words: &[(&str, T)], table: &DeTable<'t>) -> Option<T> {
        let node = table.get(name)?;
        let found = node.get_ref().as_str();
        let known = words.iter().find(|(word, _)| Some(*word) == found);
        if known.is_none() {
            let all: Vec<String> = words.iter().map(|(word, _)| format!("\"{word}\"")).collect();
            self.expected(name, &all.join(" or "), node);
        }
        known.map(|(_, value)| *value)
    }

    fn people(&mut self, root: &DeTable<'t>, model: &mut ModelFile) {
        if let Some(table) = self.table("people", root) {
            self.only_keys("[people]", &["draw"], table);
            let words =
                [("with replacement", PeopleDraw::WithReplacement), ("each", PeopleDraw::Each)];
            model.people = self.word("draw", &words, table).unwrap_or_default();
        }
        if let Some(table) = self.table("replay", root) {
            self.only_keys("[replay]", &["order", "columns"], table);
            let words = [
                ("own", ReplayOrder::Own),
                ("cyclic", ReplayOrder::Cyclic),
                ("random", ReplayOrder::Random),
            ];
            model.replay = Some(self.word("order", &words, table).unwrap_or(ReplayOrder::Own));
            let columns = table.get("columns").map(|node| self.names("columns", node));
            match columns {
                Some(columns) => {
                    for (name, at) in columns {
                        self.check_name("a column of [replay]", &name, at);
                        model.replayed.push(name);
                    }
                }
                None => {
                    let at = root.get("replay").map_or(Span { start: 0, end: 0 }, span);
                    self.fault(at, "[replay]: `columns` is missing: the columns of its file that the model uses");
                }
            }
        }
    }

    pub fn table<'n>(&mut self, name: &str, root: &'n DeTable<'t>) -> Option<&'n DeTable<'t>> {
        let node = root.get(name)?;
        let table = node.get_ref().as_table();
        if table.is_none() {
            self.expected(name, "a table", node);
        }
        table
    }

    /// A list of texts with their positions; a text alone is a list of one.
    pub fn names(&mut self, name: &str, node: &TomlNode<'t>) -> Vec<(String, Span)> {
        let items = match node.get_ref() {
            DeValue::String(text) => return vec![(text.to_string(), span(node))],
            DeValue::Array(items) => items,
            _ => {
                self.expected(name, "a list of names", node);
                return Vec::new();
            }
        };
        let mut names = Vec::new();
        for item in items.iter() {
            match item.get_ref() {
                DeValue::String(text) => names.push((text.to_string(), span(item))),
                _ => self.expected(name, "a name", item),
            }
        }
        names
    }

    /// Reports a name that expressions cannot use.
    fn check_name(&mut self, what: &str, name: &str, at: Span) {
        let is_word = |c: char| c.is_ascii_alphanumeric() || c == '_';
        let begins = name.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_');
        let name = shortened(name);
        if !begins || !name.chars().all(is_word) || name.len() > 64 {
            let help = "names have at most 64 letters, digits and underscores, and do not begin with a digit";
            self.faults.add(Fault::at(at, format!("`{name}` cannot name {what}")).help(help));
        } else if let Some(meaning) = reserved(&name) {
            let fault = Fault::at(at, format!("`{name}` cannot name {what}: it is {meaning}"));
            self.faults.add(fault.help("choose another name"));
        }
    }

    fn quantities(&mut self, root: &DeTable<'t>, draft: &mut ModelDraft) {
        let person = self.entries("person", root).into_iter().map(|entry| (Moment::Person, entry));
        let person: Vec<_> = person.collect();
        let variables = self.entries("variables", root);
        if variables.is_empty() && root.get("variables").is_none() {
            self.faults.add(Fault::whole("[variables] is missing: what the model computes"));
        }
        let variables = variables.into_iter().map(|entry| (Moment::Before, entry));
        for (stage, (name, at, node)) in person.into_iter().chain(variables) {
            if draft.quantities.len() == MOST_VARIABLES {
                self.fault(at, format!("a model has at most {MOST_VARIABLES} variables"));
                break;
            }
            self.check_name("a variable", name, at);
            match self.definition(name, node) {
                Some(definition) => draft.quantities.push(Quantity {
                    name: name.to_owned(),
                    span: at,
                    stage,
                    definition,
                    back: 0,
                }),
                None => draft.faulty.push(name.to_owned()),
            }
        }
    }

    fn definition(&mut self, name: &str, node: &TomlNode<'t>) -> Option<Definition> {
        let Some(table) = node.get_ref().as_table() else {
            return self.formula(name, node).map(Definition::NamedExpression);
        };
        let names: Vec<&str> = FORMS.iter().map(|form| form.name).collect();
        if table.contains_key("table") {
            return self.table_draw(name, table);
        }
        let mut keys = table.keys();
        let (Some(key), None) = (keys.next(), keys.next()) else {
            self.expected(
                name,
                "an expression, or one distribution as in { gaussian = [0, 1] }",
                node,
            );
            return None;
        };
        let found = key.get_ref().as_ref();
        if !names.contains(&found) {
            let at = key.span().into();
            let fault = Fault::at(at, format!("`{name}`: there is no distribution `{found}`"));
            let mut all = names.clone();
            all.dedup();
            let fault = match nearest(found, all.iter().copied()) {
                Some(word) => fault.help(format!("did you mean `{word}`?")),
                None => fault.help(format!("the distributions are {} and table", all.join(", "))),
            };
            self.faults.add(fault);
            return None;
        }
        let forms: Vec<&Form> = FORMS.iter().filter(|form| form.name == found).collect();
        self.draw(name, &forms, &table[found])
            .map(|(distribution, formulas)| Definition::DrawInstruction(distribution, formulas))
    }

    /// The parameters of a distribution: a list, a table, or one value.
    fn draw(
        &mut self,
        name: &str,
        forms: &[&Form],
        node: &TomlNode<'t>,
    ) -> Option<(DrawLaw, Vec<NamedExpression>)> {
        let first = forms[0];
        let ways: Vec<String> = forms.iter().map(|form| form.keys.join(", ")).collect();
        let (form, nodes): (&Form, Vec<&TomlNode<'t>>) = match node.get_ref() {
            DeValue::Table(table) => {
                let fits = |form: &&&Form| {
                    table.len() == form.keys.len()
                        && form.keys.iter().all(|key| table.contains_key(*key))
                };
                let Some(form) = forms.iter().find(fits) else {
                    let expected = format!("the parameters {}", ways.join(", or "));
                    self.expected(&format!("{name}.{}", first.name), &expected, node);
                    return None;
                };
                (form, form.keys.iter().map(|key| &table[*key]).collect())
            }
            DeValue::Array(items) if !first.distribution.is_list() => {
                (first, items.iter().collect())
            }
            _ => (first, vec![node]),
        };
        let nodes = match nodes[..] {
            [list] if form.distribution.is_list() => match list.get_ref() {
                DeValue::Array(items) => items.iter().collect(),
                _ => Vec::new(),
            },
            _ => nodes,
        };
        let is_right = match form.distribution.is_list() {
            true => (2..=256).contains(&nodes.len()),
            false => nodes.len() == form.keys.len(),
        };
        if !is_right {
            let expected = match form.distribution.is_list() {
                true => "a list of 2 to 256 expressions".to_owned(),
                false => format!("the parameters {}", ways.join(", or ")),
            };
            self.expected(&format!("{name}.{}", first.name), &expected, node);
            return None;
        }
        let formulas: Vec<Option<NamedExpression>> =
            nodes.into_iter().map(|node| self.formula(name, node)).collect();
        Some((form.distribution, formulas.into_iter().collect::<Option<Vec<NamedExpression>>>()?))
    }

    /// An expression, or a number.
    fn formula(&mut self, name: &str, node: &TomlNode<'t>) -> Option<NamedExpression> {
        let whole = span(node);
        if let Some(number) = written_number(node) {
            let position = TextPosition { start: None, whole: (whole.start, whole.end) };
            return Some(NamedExpression {
                expression: Expression::number(number),
                position,
                ..NamedExpression::default()
            });
        }
        let Some(text) = node.get_ref().as_str() else {
            self.expected(name, "an expression as a text, or a number", node);
            return None;
        };
        let position = position(self.text, text, whole);
        match grammar::read(text) {
            Ok(expression) => {
                Some(NamedExpression { expression, position, ..NamedExpression::default() })
            }
            Err(fault) => {
                let at = position.span(&fault.span);
                let located = Fault::at(at, format!("`{name}`: {}", fault.says));
                self.faults.add(match fault.help {
                    Some(help) => located.help(help),
                    None => located,
                });
                None
            }
        }
    }

    fn read_tables(&mut self, root: &DeTable<'t>) {
        for (name, at, node) in self.entries("tables", root) {
            self.check_name("a table", name, at);
            let Some(text) = node.get_ref().as_str() else {
                self.expected(name, "the text of a CSV file in three quotes", node);
                continue;
            };
            match read_table(text) {
                Ok((table, given)) => self.tables.push((name.to_owned(), table, given)),
                Err(says) => self.fault(span(node), format!("`{name}`: {says}")),
            }
        }
    }

    /// A draw from a table, given other values.
    fn table_draw(&mut self, name: &str, entries: &DeTable<'t>) -> Option<Definition> {
        self.only_keys(name, &["table", "given"], entries);
        let node = &entries["table"];
        let found = node.get_ref().as_str().unwrap_or_default();
        let known = self.tables.iter().find(|(known, ..)| known == found).cloned();
        let Some((_, table, given)) = known else {
            let names: Vec<&str> = self.tables.iter().map(|(name, ..)| name.as_str()).collect();
            let fault = Fault::at(span(node), format!("`{name}`: [tables] has no `{found}`"));
            self.faults.add(fault.nearest(found, names));
            return None;
        };
        let items: Vec<&TomlNode<'t>> = match entries.get("given").map(|node| node.get_ref()) {
            Some(DeValue::Array(items)) => items.iter().collect(),
            _ => Vec::new(),
        };
        if items.len() != given {
            let says = format!(
                "`{name}`: `given` needs {given} expressions, one for each column before value"
            );
            self.fault(span(node), says);
            return None;
        }
        let formulas: Vec<Option<NamedExpression>> =
            items.into_iter().map(|node| self.formula(name, node)).collect();
        Some(Definition::ProbabilityTable(table, formulas.into_iter().collect::<Option<Vec<_>>>()?))
    }

    fn blocks(&mut self, root: &DeTable<'t>, draft: &mut ModelDraft) {
        for (name, at, node) in self.entries("linear", root) {
            self.check_name("a block", name, at);
            let Some(table) = node.get_ref().as_table() else {
                let expected = "a table, as in { prefix = \"b_\", features = [\"x\", \"1\"] }";
                self.expected(name, expected, node);
                draft.faulty.push(name.to_owned());
                continue;
            };
            self.only_keys(&format!("linear.{name}"), &["prefix", "features"], table);
            let prefix = table.get("prefix").and_then(|node| node.get_ref().as_str());
            let features = table.get("features");
            let (Some(prefix), Some(features)) = (prefix, features) else {
                self.expected(name, "a `prefix` and `features`", node);
                draft.faulty.push(name.to_owned());
                continue;
            };
            let same_as = features.get_ref().as_str();
            let same_as = same_as.map(|other| (other.to_owned(), span(features)));
            let features = match same_as {
                Some(_) => Vec::new(),
                None => self.names(name, features),
            };
            draft.blocks.push(CoefficientBlock {
                name: name.to_owned(),
                span: at,
                prefix: prefix.to_owned(),
                features,
                same_as,
            });
        }
    }

    fn roles(&mut self, root: &DeTable<'t>) -> DraftRoles {
        let mut roles = DraftRoles::default();
        let Some(table) = self.table("roles", root) else {
            if root.get("roles").is_none() {
                let fault =
                    Fault::whole("[roles] is missing: it names the `outcome` and the `features`");
                self.faults.add(fault);
            }
            roles.is_outcome_faulty = true;
            return roles;
        };
        roles.span = root.get("roles").map(span);
        let keys = ["outcome", "reward", "available", "ends", "features", "state"];
        self.only_keys("[roles]", &keys, table);
        let mut role = |name: &str| table.get(name).map(|node| self.formula(name, node));
        let outcome = role("outcome");
        roles.is_outcome_faulty = matches!(outcome, Some(None));
        roles.outcome = outcome.flatten();
        [roles.reward, roles.available, roles.ends] =
            ["reward", "available", "ends"].map(|name| role(name).flatten());
        roles.state = table.get("state").map(|node| self.names("state", node));
        match table.get("features").map(|node| (node, node.get_ref())) {
            Some((_, DeValue::Array(items))) if !items.is_empty() => {
                roles.features = items.iter().filter_map(|item| self.feature(item)).collect();
            }
            Some((node, _)) => self.expected("features", "a list of names", node),
            None => {
                let at = roles.span.unwrap_or(Span { start: 0, end: 0 });
                self.fault(at, "[roles]: `features` is missing: what agents may observe");
            }
        }
        roles
    }

    fn feature(&mut self, node: &TomlNode<'t>) -> Option<DraftFeature> {
        let plain = |name: &str| DraftFeature {
            name: name.to_owned(),
            span: span(node),
            low: f64::NEG_INFINITY,
            high: f64::INFINITY,
            unit: String::new(),
            meaning: String::new(),
        };
        match node.get_ref() {
            DeValue::String(name) => Some(plain(name)),
            DeValue::Table(table) => {
                self.only_keys("a feature", &["name", "low", "high", "unit", "meaning"], table);
                let Some(name) = table.get("name").and_then(|node| node.get_ref().as_str()) else {
                    self.expected("features", "a table with a `name`", node);
                    return None;
                };
                let mut feature = plain(name);
                if let Some(node) = table.get("low") {
                    feature.low = self.number("low", node).unwrap_or(feature.low);
                }
                if let Some(node) = table.get("high") {
                    feature.high = self.number("high", node).unwrap_or(feature.high);
                }
                if feature.low >= feature.high {
                    self.fault(span(node), format!("`{name}`: `low` is not below `high`"));
                }
                feature.unit = self.words("unit", table).unwrap_or_default();
                feature.meaning = self.words("meaning", table).unwrap_or_default();
                Some(feature)
            }
            _ => {
                self.expected(
                    "features",
                    "a name, or a table as in { name = \"x\", low = 0, high = 1 }",
                    node,
                );
                None
            }
        }
    }
}

/// The entries of a table by their positions.
pub(super) fn sorted<'n, 't>(table: &'n DeTable<'t>) -> Vec<(&'n str, Span, &'n TomlNode<'t>)> {
    let mut entries: Vec<(&str, Span, &TomlNode<'t>)> =
        table.iter().map(|(key, node)| (key.get_ref().as_ref(), key.span().into(), node)).collect();
    entries.sort_by_key(|(_, span, _)| *span);
    entries
}

/// A number of TOML that is finite.
fn written_number(node: &TomlNode<'_>) -> Option<f64> {
    let number: Option<f64> = match node.get_ref() {
        DeValue::Integer(integer) => {
            i64::from_str_radix(integer.as_str(), integer.radix()).ok().map(|whole| whole as f64)
        }
        DeValue::Float(float) => float.as_str().replace('_', "").parse().ok(),
        DeValue::Boolean(flag) => Some(f64::from(u8::from(*flag))),
        _ => None,
    };
    number.filter(|number| number.is_finite())
}

/// Whether a text is short, without characters that change the display of others.
fn is_short(text: &str) -> bool {
    text.chars().count() <= 200 && text.chars().all(|c| hidden(c).is_none())
}

/// What a name means that models cannot give another meaning.
fn reserved(name: &str) -> Option<&'static str> {
    if Clock::NAMED.iter().any(|(clock, _)| *clock == name) {
        return Some("a clock");
    }
    if matches!(name, "action" | "probability") {
        return Some("what was chosen");
    }
    if matches!(name, "policy" | "reported" | "reached" | "gross_reward") {
        return Some("a number that a trial records");
    }
    if matches!(name, "person" | "can_send") {
        return Some("a column that stands beside the recorded variables");
    }
    OPERATORS.contains(&name).then_some("an operator")
}

/// Where a text stands that a value in the file has.
fn position(file: &str, text: &str, whole: Span) -> TextPosition {
    let written = file.get(whole.start..whole.end).unwrap_or_default();
    let quotes = if written.starts_with("\"\"\"") || written.starts_with("'''") { 3 } else { 1 };
    let mut start = whole.start + quotes;
    if quotes == 3 {
        let rest = file.get(start..).unwrap_or_default();
        start += if rest.starts_with("\r\n") { 2 } else { usize::from(rest.starts_with('\n')) };
    }
    let is_same = file.get(start..).is_some_and(|rest| rest.starts_with(text));
    TextPosition { start: is_same.then_some(start), whole: (whole.start, whole.end) }
}

/// A table of probabilities, and the number of columns that are given. The last two columns are the value and its
/// probability, or its weight.
///
/// **Errors**: the text is not such a table; rows that are given the same have no positive weight.
fn read_table(text: &str) -> Result<(ProbabilityTable, usize), String> {
    let begin = |names: &csv::StringRecord| {
        let names: Vec<&str> = names.iter().collect();
        match names[..] {
            [.., "value", "probability"] => Ok((ProbabilityTable::default(), names.len() - 2)),
            _ => Err("the last two columns must be value and probability".to_owned()),
        }
    };
    let push = |(table, given): &mut (ProbabilityTable, usize), record: &csv::StringRecord| {
        let mut numbers = Vec::new();
        for written in record {
            let number = written.parse().ok().filter(|number: &f64| number.is_finite());
            numbers.push(number.ok_or_else(|| format!("expected a number, found {written}"))?);
        }
        let probability = numbers[*given + 1];
        if probability < 0.0 {
            return Err(format!("a probability is at least 0, found {probability}"));
        }
        table.given.extend_from_slice(&numbers[..*given]);
        table.values.push((numbers[*given], probability));
        Ok(())
    };
    let (table, given) = read_csv(text, begin, push)?;
    if table.values.is_empty() {
        return Err("expected at least one row".to_owned());
    }
    Ok((table, given))
}
