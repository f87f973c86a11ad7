//! The keys that set the layout of an analysis's figures: panels, size, letters, limits, theme.

use serde_json::{Value as Json, json};
use toml::de::DeTable;

use super::fault::Fault;
use super::parameter::{meant, named};
use super::source::Located;
use super::sweep::{Node, Reader};
use super::written::quoted;
use crate::key::{Kind, Parameter, Value, choices};

/// The layout of the figures of an analysis; `None` stands for the default.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FigureKeys {
    /// What distinguishes panels.
    pub panel: Option<PanelKey>,
    /// Width in millimetres.
    pub width: Option<f64>,
    /// Height in millimetres.
    pub height: Option<f64>,
    /// Size of the letters in points.
    pub font_size: Option<f64>,
    /// The lower end of the vertical axis.
    pub y_min: Option<f64>,
    /// The upper end of the vertical axis.
    pub y_max: Option<f64>,
    /// The scale of the horizontal axis; chosen by its numbers if `None`.
    pub x_scale: Option<XScale>,
    /// The medium of the figures.
    pub theme: Theme,
}

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

#[expect(clippy::derivable_impls, reason = "`choices` takes no attribute of a variant")]
impl Default for Theme {
    fn default() -> Theme {
        Theme::Screen
    }
}

/// Limits of a figure in millimetres, and of its letters in points.
pub(super) const SIDES: (f64, f64) = (30.0, 600.0);
pub(super) const LETTERS: (f64, f64) = (4.0, 24.0);

impl Reader<'_> {
    /// Reads the keys of a figure.
    pub(super) fn figure_keys(
        &mut self,
        table: &DeTable,
        panels: &mut Vec<Located<Parameter>>,
    ) -> FigureKeys {
        let mut number = |name: &str, (min, max): (f64, f64)| {
            let node = table.get(name)?;
            match self.value(name, Kind::Real { min, max }, node)? {
                Value::Real(number) => Some(number),
                _ => None,
            }
        };
        let all = (-1e9, 1e9);
        let (width, height) = (number("width", SIDES), number("height", SIDES));
        let font_size = number("font_size", LETTERS);
        let (y_min, y_max) = (number("y_min", all), number("y_max", all));
        if let (Some(low), Some(high), Some(node)) = (y_min, y_max, table.get("y_max"))
            && low >= high
        {
            self.expected("y_max", "a number above `y_min`", node);
        }
        let theme = table.get("theme").and_then(|node| self.word("theme", Theme::WORDS, node));
        let theme = theme.and_then(Theme::named).unwrap_or_default();
        let x_scale =
            table.get("x_scale").and_then(|node| self.word("x_scale", XScale::WORDS, node));
        let x_scale = x_scale.and_then(XScale::named);
        let panel = table.get("panel").and_then(|node| self.panel(node, panels));
        FigureKeys { panel, width, height, font_size, y_min, y_max, x_scale, theme }
    }

    fn panel(&mut self, node: &Node, panels: &mut Vec<Located<Parameter>>) -> Option<PanelKey> {
        let found = node.get_ref().as_str().unwrap_or_default();
        if matches!(found, "agent" | "agent.name") {
            return Some(PanelKey::Agent);
        }
        match named(found) {
            Some(Parameter::SCENARIO) => Some(PanelKey::Scenario),
            Some(
                swept @ (Parameter::Environment(_)
                | Parameter::Population(_)
                | Parameter::Agent(_)
                | Parameter::Evaluation(_)),
            ) => {
                panels.push(Located { value: swept, span: node.span().into() });
                Some(PanelKey::Key(swept))
            }
            Some(Parameter::Job(_)) | None => {
                let expected = "\"agent\", \"scenario\" or the dotted name of a swept key";
                let message = format!("`panel`: expected {expected}, found {}", self.found(node));
                let fault = Fault::at(node.span().into(), message);
                self.faults.add(match meant(found, &["agent"]).filter(|name| name != "seed") {
                    Some(name) => fault.help(format!("did you mean `{name}`?")),
                    None => fault,
                });
                None
            }
        }
    }
}

impl FigureKeys {
    /// The declared keys with their values, as a manifest writes them.
    pub(super) fn written(&self) -> Vec<(&'static str, String)> {
        let panel = self.panel.map(|panel| match panel {
            PanelKey::Agent => quoted(&"agent"),
            PanelKey::Scenario => quoted(&"scenario"),
            PanelKey::Key(parameter) => quoted(&parameter),
        });
        let number = |number: Option<f64>| number.map(|number| format!("{number:?}"));
        let theme = (self.theme != Theme::default()).then(|| quoted(&self.theme.word()));
        let all = [
            ("panel", panel),
            ("width", number(self.width)),
            ("height", number(self.height)),
            ("font_size", number(self.font_size)),
            ("y_min", number(self.y_min)),
            ("y_max", number(self.y_max)),
            ("x_scale", self.x_scale.map(|scale| quoted(&scale.word()))),
            ("theme", theme),
        ];
        all.into_iter().filter_map(|(key, value)| Some((key, value?))).collect()
    }

    pub(super) fn theme_schema() -> Json {
        json!({ "enum": Theme::WORDS, "default": Theme::WORDS[0] })
    }

    pub(super) fn x_scale_schema() -> Json {
        json!({ "enum": XScale::WORDS })
    }

    pub(super) fn panel_schema() -> Json {
        json!({ "anyOf": [
            { "enum": ["agent", "agent.name"] },
            { "$ref": "#/$defs/parameter" },
        ] })
    }
}
