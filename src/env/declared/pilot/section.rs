//! The section `[fit]` of a model: how a file of decisions gives its variables, and how its coefficients are estimated.

use toml::de::{DeTable, DeValue};

use crate::env::declared::read::{ModelReader, TomlNode, sorted, span};
use crate::text::{Fault, FaultList, Span, document};

/// An expression of the file's columns, as it is written.
#[derive(Clone, Debug)]
pub(in crate::env) struct WrittenColumn {
    pub text: String,
    pub span: Span,
}

/// How the rows of a person give one number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum RowsToOne {
    First,
    Mean,
    Least,
    Most,
}

/// How the coefficients of a draw are estimated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FitMethod {
    /// Least squares; maximum likelihood where the draw is neither normal nor lognormal.
    LeastSquares,
    /// The same with this multiple of half the sum of squared weights added, the intercept left out.
    Ridge(f64),
    /// The largest posterior density: every coefficient is normal around 0 with this standard deviation.
    Map(f64),
    /// Counts of a table's rows.
    Counts,
}

/// Where the effects of an action come from.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum EffectSource {
    /// From the data.
    #[default]
    Fitted,
    /// A share of the residual standard deviation.
    Standardised(f64),
    /// A share of the mean size of the other weights.
    ShareOfWeights(f64),
}

/// The section.
#[derive(Clone, Debug, Default)]
pub(super) struct FitSection {
    pub person: Option<WrittenColumn>,
    pub order: Vec<WrittenColumn>,
    pub filter: Option<WrittenColumn>,
    pub action: Option<WrittenColumn>,
    /// Of action 1, or of every action but the first.
    pub probability: Vec<WrittenColumn>,
    pub available: Option<WrittenColumn>,
    /// Variables by name.
    pub columns: Vec<(String, Span, WrittenColumn)>,
    /// Columns of people by name.
    pub people: Vec<(String, Span, RowsToOne, WrittenColumn)>,
    pub standardised: Vec<(String, Span)>,
    /// By variable, the least share of rows with either value.
    pub least_share: Vec<(String, Span, f64)>,
    /// By draw; the first is of all that are not listed.
    pub methods: Vec<(Option<String>, Span, FitMethod)>,
    pub pooled: bool,
    pub effect: EffectSource,
    /// Columns whose imputed effect is negative.
    pub negative: Vec<(String, Span)>,
}

const KEYS: [&str; 13] = [
    "person",
    "order",
    "where",
    "action",
    "probability",
    "available",
    "columns",
    "people",
    "standardise",
    "least_share",
    "method",
    "pooled",
    "effect",
];

/// The words of methods.
const METHODS: [&str; 4] = ["least squares", "ridge", "map", "counts"];

/// Reads the section of a model that is valid otherwise.
///
/// **Errors**: every fault of the section.
pub(super) fn read(text: &str) -> Result<FitSection, FaultList> {
    let document = document(text);
    let mut reader =
        SectionReader { reader: ModelReader::new(text), section: FitSection::default() };
    match document.root.get_ref().get("fit").map(|node| (node, node.get_ref().as_table())) {
        Some((_, Some(table))) => reader.read(table),
        Some((node, None)) => reader.reader.expected("fit", "a table", node),
        None => {
            let help =
                "[fit] says which column of the data is which variable; docs/fit.md has examples";
            reader.reader.faults.add(Fault::whole("the model has no [fit]").help(help));
        }
    }
    let SectionReader { reader, section } = reader;
    if reader.faults.is_empty() { Ok(section) } else { Err(reader.faults) }
}

struct SectionReader<'t> {
    reader: ModelReader<'t>,
    section: FitSection,
}

impl<'t> SectionReader<'t> {
    fn read(&mut self, table: &DeTable<'t>) {
        self.reader.only_keys("[fit]", &KEYS, table);
        self.section.person = self.column("person", table);
        if !table.contains_key("person") {
            let says = "[fit]: `person` is missing: the column that names people";
            self.reader.faults.add(Fault::whole(says));
        }
        self.section.order = self.columns("order", table);
        if let [_, _, third, ..] = &self.section.order[..] {
            let says = "`order`: expected one column, or two: the day, and the decision of the day";
            self.reader.faults.add(Fault::at(third.span, says));
        }
        self.section.filter = self.column("where", table);
        self.section.action = self.column("action", table);
        self.section.probability = self.columns("probability", table);
        self.section.available = self.column("available", table);
        for (name, at, node) in self.entries("columns", table) {
            if let Some(written) = self.written(name, node) {
                self.section.columns.push((name.to_owned(), at, written));
            }
        }
        for (name, at, node) in self.entries("people", table) {
            self.person_column(name, at, node);
        }
        if let Some(node) = table.get("standardise") {
            self.section.standardised = self.reader.names("standardise", node);
        }
        for (name, at, node) in self.entries("least_share", table) {
            if let Some(share) = self.number(name, (0.0, 0.5), node) {
                self.section.least_share.push((name.to_owned(), at, share));
            }
        }
        self.methods(table);
        self.section.pooled = match table.get("pooled").map(|node| (node, node.get_ref())) {
            None => false,
            Some((_, DeValue::Boolean(flag))) => *flag,
            Some((node, _)) => {
                self.reader.expected("pooled", "true or false", node);
                false
            }
        };
        self.effect(table);
    }

    fn entries<'n>(
        &mut self,
        name: &str,
        table: &'n DeTable<'t>,
    ) -> Vec<(&'n str, Span, &'n TomlNode<'t>)> {
        self.reader.table(name, table).map(sorted).unwrap_or_default()
    }

    fn column(&mut self, name: &str, table: &DeTable<'t>) -> Option<WrittenColumn> {
        table.get(name).and_then(|node| self.written(name, node))
    }

    fn columns(&mut self, name: &str, table: &DeTable<'t>) -> Vec<WrittenColumn> {
        let names = table.get(name).map(|node| self.reader.names(name, node));
        let written = |(text, span)| WrittenColumn { text, span };
        names.unwrap_or_default().into_iter().map(written).collect()
    }

    fn written(&mut self, name: &str, node: &TomlNode<'t>) -> Option<WrittenColumn> {
        let text = node.get_ref().as_str();
        if text.is_none() {
            self.reader.expected(name, "the name of a column, or an expression of columns", node);
        }
        Some(WrittenColumn { text: text?.to_owned(), span: span(node) })
    }

    fn number(
        &mut self,
        name: &str,
        (least, most): (f64, f64),
        node: &TomlNode<'t>,
    ) -> Option<f64> {
        let number = self.reader.number(name, node)?;
        let is_inside = number > least && number <= most;
        if !is_inside {
            let most =
                if most == f64::MAX { String::new() } else { format!(" and at most {most}") };
            self.reader.expected(name, &format!("a number above {least}{most}"), node);
        }
        is_inside.then_some(number)
    }

    fn person_column(&mut self, name: &str, at: Span, node: &TomlNode<'t>) {
        let ways = [
            ("first", RowsToOne::First),
            ("mean", RowsToOne::Mean),
            ("min", RowsToOne::Least),
            ("max", RowsToOne::Most),
        ];
        let table = node.get_ref().as_table().filter(|table| table.len() == 1);
        let way = table.and_then(|table| {
            let (key, node) = table.iter().next()?;
            let way = ways.iter().find(|(way, _)| *way == key.get_ref().as_ref())?;
            Some((way.1, node))
        });
        let Some((way, node)) = way else {
            let expected = "a table as in { first = \"age\" }, with first, mean, min or max";
            self.reader.expected(name, expected, node);
            return;
        };
        if let Some(written) = self.written(name, node) {
            self.section.people.push((name.to_owned(), at, way, written));
        }
    }

    fn methods(&mut self, table: &DeTable<'t>) {
        let Some(node) = table.get("method") else { return };
        let (mut prior_sd, mut penalty) = (1.0, 1.0);
        let mut words = Vec::new();
        match node.get_ref() {
            DeValue::String(_) => words.push((None, span(node), node)),
            DeValue::Table(table) => {
                for (name, at, node) in sorted(table) {
                    match name {
                        "prior_sd" => {
                            prior_sd = self.number(name, (0.0, f64::MAX), node).unwrap_or(1.0);
                        }
                        "penalty" => {
                            penalty = self.number(name, (0.0, f64::MAX), node).unwrap_or(1.0);
                        }
                        _ => words.push((Some(name.to_owned()), at, node)),
                    }
                }
            }
            _ => self.reader.expected("method", "a method, or a table of draws and methods", node),
        }
        for (name, at, node) in words {
            let method = match node.get_ref().as_str() {
                Some("least squares") => FitMethod::LeastSquares,
                Some("ridge") => FitMethod::Ridge(penalty),
                Some("map") => FitMethod::Map(prior_sd),
                Some("counts") => FitMethod::Counts,
                _ => {
                    let expected = format!("\"{}\"", METHODS.join("\", \""));
                    self.reader.expected("method", &expected, node);
                    continue;
                }
            };
            self.section.methods.push((name, at, method));
        }
    }

    fn effect(&mut self, table: &DeTable<'t>) {
        let Some(node) = table.get("effect") else { return };
        let expected = "\"fit\", { standardised = 0.3 } or { share_of_weights = 0.25 }, with negative = [\"column\"]";
        let Some(table) = node.get_ref().as_table() else {
            if node.get_ref().as_str() != Some("fit") {
                self.reader.expected("effect", expected, node);
            }
            return;
        };
        self.reader.only_keys("effect", &["standardised", "share_of_weights", "negative"], table);
        let ways = ["standardised", "share_of_weights"];
        let given: Vec<&str> = ways.into_iter().filter(|way| table.contains_key(*way)).collect();
        let [way] = given[..] else {
            self.reader.expected("effect", expected, node);
            return;
        };
        if let Some(share) = self.reader.number(way, &table[way]) {
            self.section.effect = match way {
                "standardised" => EffectSource::Standardised(share),
                _ => EffectSource::ShareOfWeights(share),
            };
        }
        if let Some(node) = table.get("negative") {
            self.section.negative = self.reader.names("negative", node);
        }
    }
}

impl FitSection {
    /// The method of a draw.
    pub fn method(&self, draw: &str) -> FitMethod {
        let own = self.methods.iter().find(|(name, ..)| name.as_deref() == Some(draw));
        let all = || self.methods.iter().find(|(name, ..)| name.is_none());
        own.or_else(all).map_or(FitMethod::LeastSquares, |(.., method)| *method)
    }
}
