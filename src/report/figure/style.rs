//! The style of a figure: its size, its font size, the limits of its axis, and whether it has titles.

use super::axis::AxisScale;
use super::{NOTE, TEXT, WIDTH};
use crate::manifest::{FigureKeys, PanelKey, Theme, XScale};
use crate::report::scene::Scene;

/// Units per millimetre.
const MILLIMETRE: f64 = 96.0 / 25.4;

/// Units per point, the unit of the declared font size.
const POINT: f64 = 96.0 / 72.0;

/// The style of a figure. Lengths refer to a layout with the default font size, which
/// [`Style::set`] scales to the declared font size.
#[derive(Clone, Debug)]
pub struct Style {
    /// The key that distinguishes panels, if one is declared.
    pub panel: Option<PanelKey>,
    /// Declared font size, relative to the default.
    scale: f64,
    width: Option<f64>,
    height: Option<f64>,
    /// The declared ends of the vertical axis.
    pub limits: (Option<f64>, Option<f64>),
    x_scale: Option<XScale>,
    theme: Theme,
}

impl Style {
    /// The style that an analysis declares.
    pub fn of(keys: &FigureKeys) -> Style {
        let scale = keys.font_size.map_or(1.0, |size| size * POINT / TEXT);
        let length = |millimetres: f64| millimetres * MILLIMETRE / scale;
        Style {
            panel: keys.panel,
            scale,
            width: keys.width.map(length),
            height: keys.height.map(length),
            limits: (keys.y_min, keys.y_max),
            x_scale: keys.x_scale,
            theme: keys.theme.unwrap_or(Theme::Screen),
        }
    }

    /// The width to draw at.
    pub fn width(&self) -> f64 {
        self.width.unwrap_or(WIDTH)
    }

    /// Whether the width is declared, so that labels must not make the figure wider.
    pub fn has_width(&self) -> bool {
        self.width.is_some()
    }

    /// The declared height, or the usual height.
    pub fn height(&self, usual: f64) -> f64 {
        self.height.unwrap_or(usual)
    }

    /// The height of each of several rows, with `beside` for everything else; at least half the usual height.
    pub fn row(&self, usual: f64, rows: usize, beside: f64) -> f64 {
        let declared = self.height.map(|height| (height - beside) / rows.max(1) as f64);
        declared.map_or(usual, |row| row.max(usual / 2.0))
    }

    /// The declared scale of the horizontal axis, or the usual scale.
    pub fn x_scale(&self, usual: AxisScale) -> AxisScale {
        match self.x_scale {
            None => usual,
            Some(XScale::Linear) => AxisScale::Linear,
            Some(XScale::Logarithmic) => AxisScale::Log,
        }
    }

    /// Whether a figure without panels has a heading above it and a note below it. In print, the
    /// caption contains both.
    pub fn has_titles(&self) -> bool {
        match self.theme {
            Theme::Screen => true,
            Theme::Print => false,
        }
    }

    /// The height of a note below the axes.
    pub fn note(&self) -> f64 {
        if self.has_titles() { NOTE + 3.0 } else { 0.0 }
    }

    /// The scene scaled to the declared font size.
    pub fn set(&self, scene: Scene) -> Scene {
        scene.scaled(self.scale)
    }
}
