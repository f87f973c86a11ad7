//! The keys that set the layout of an analysis's figures: panels, size, letters, limits, theme.

use serde_json::{Value as Json, json};

use crate::key::{FixedKind, Kind, Parameter, choices};
use crate::manifest::parameter::{meant, named};
use crate::manifest::table::{Field, Need, TableReader, fields};
use crate::manifest::text::written::quoted;
use crate::text::Fault;

fields! {
    /// The layout of the figures of an analysis; `None` stands for the default.
    #[derive(Copy, Default)]
    pub struct FigureKeys {
        /// the scale of the horizontal axis; chosen by its numbers by default
        x_scale: Option<XScale>, in XScale::KIND;
        /// the key by whose values figures are split into panels
        panel: Option<PanelKey>;
        /// the width of a figure in mm
        width: Option<f64>, in MILLIMETRES;
        /// the height of a figure in mm
        height: Option<f64>, in MILLIMETRES;
        /// the font size in points
        font_size: Option<f64>, in Kind::Real { min: 4.0, max: 24.0 };
        /// the lower end of the vertical axis
        y_min: Option<f64>, in LIMIT;
        /// the upper end of the vertical axis
        y_max: Option<f64>, in LIMIT;
        /// "print" for figures without heading and note, "screen" by default
        theme: Option<Theme>, in Theme::KIND;
    }
}

/// Widths and heights.
const MILLIMETRES: Kind = Kind::Real { min: 30.0, max: 600.0 };
/// Ends of an axis.
const LIMIT: Kind = Kind::Real { min: -1e9, max: 1e9 };

/// What distinguishes the panels of a figure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PanelKey {
    /// The agent.
    Agent,
    /// The scenario.
    Scenario,
    /// A swept key.
    Key(Parameter),
}

choices! {
    /// The medium of a figure.
    pub enum Theme {
        /// A web page: figures have a heading and a note.
        Screen = "screen",
        /// An article: its caption replaces heading and note.
        Print = "print",
    }
}

choices! {
    /// The scale of a horizontal axis.
    pub enum XScale {
        /// Equal differences are equally long.
        Linear = "linear",
        /// Equal ratios are equally long.
        Logarithmic = "logarithmic",
    }
}

impl Field for PanelKey {
    type Value = PanelKey;

    fn schema(_: Option<Kind>) -> Json {
        json!({ "anyOf": [
            { "enum": ["agent", "agent.name"] },
            { "$ref": "#/$defs/parameter" },
        ] })
    }

    fn read(table: &mut TableReader<'_, '_>, key: &str, _: Option<Kind>) -> Option<PanelKey> {
        let node = table.node(key)?;
        let found = node.get_ref().as_str().unwrap_or_default();
        if matches!(found, "agent" | "agent.name") {
            return Some(PanelKey::Agent);
        }
        match named(table.reader.family, found) {
            Some(Parameter::SCENARIO) => Some(PanelKey::Scenario),
            Some(Parameter::Job(_)) | None => {
                let expected = "\"agent\", \"scenario\" or the dotted name of a swept key";
                let found_words = table.reader.found(node);
                let message = format!("`{key}`: expected {expected}, found {found_words}");
                let fault = Fault::at(node.span().into(), message);
                let meant = meant(found, &["agent"]).filter(|name| name != "seed");
                table.reader.faults.add(match meant {
                    Some(name) => fault.help(format!("did you mean `{name}`?")),
                    None => fault,
                });
                None
            }
            Some(swept) => {
                table.need(node.span().into(), Need::Values(swept));
                Some(PanelKey::Key(swept))
            }
        }
    }

    fn written(value: &PanelKey, key: &'static str) -> Vec<(&'static str, String)> {
        let word = match value {
            PanelKey::Agent => quoted(&"agent"),
            PanelKey::Scenario => quoted(&"scenario"),
            PanelKey::Key(parameter) => quoted(parameter),
        };
        vec![(key, word)]
    }
}
