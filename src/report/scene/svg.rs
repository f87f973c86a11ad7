//! A scene as SVG.

use std::fmt::Write as _;

use maud::html;

use super::script::{Level, runs};
use super::{
    Anchor, Color, Direction, Facets, Fill, Mark, Point, Scene, SceneShape, Stroke, web_font,
};

/// Millimetres per unit, which is a CSS pixel.
const MILLIMETRES: f64 = 25.4 / 96.0;

/// The scene as a standalone file, with its font.
pub fn svg(scene: &Scene) -> String {
    let [width, height] = [scene.width, scene.height].map(|units| number(units * MILLIMETRES));
    let size = format!(" width=\"{width}mm\" height=\"{height}mm\"");
    let written: String = scene.marks.iter().filter_map(|mark| mark.shape.written()).collect();
    let font = format!("<defs><style>{}</style></defs>", web_font(&written));
    format!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n{}\n",
        element(scene, &size, &font, &|_| String::new())
    )
}

/// The scene as an element of a page that contains the font. `classes` returns the CSS classes of a series.
pub fn inline_svg(scene: &Scene, classes: &dyn Fn(&Facets) -> String) -> String {
    element(scene, "", "", classes)
}

fn element(scene: &Scene, size: &str, head: &str, classes: &dyn Fn(&Facets) -> String) -> String {
    let classes: Vec<String> = scene.series.iter().map(classes).collect();
    let (width, height) = (number(scene.width), number(scene.height));
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\"{size} \
         role=\"img\" font-family=\"'Jitai Figures', Inter, Helvetica, Arial, sans-serif\">\
         <title>{}</title>{head}<rect width=\"{width}\" height=\"{height}\" fill=\"#fff\"/>",
        escaped(&scene.description)
    );
    for mark in &scene.marks {
        write_mark(&mut out, mark, &classes);
    }
    out.push_str("</svg>");
    out
}

fn write_mark(out: &mut String, mark: &Mark, classes: &[String]) {
    let mut more = String::new();
    if let Some(series) = mark.series {
        let _ = write!(more, " data-series=\"{series}\"");
    }
    let of_series = mark.series.and_then(|series| classes.get(series));
    if let Some(classes) = of_series.filter(|classes| !classes.is_empty()) {
        let _ = write!(more, " class=\"{classes}\"");
    }
    if let Some(tip) = &mark.tip {
        let _ = write!(more, " data-tip=\"{}\"", escaped(tip));
    }
    let written = match &mark.shape {
        SceneShape::Line { points, stroke } => {
            write!(
                out,
                "<polyline points=\"{}\" fill=\"none\"{}{more}/>",
                list(points),
                line(stroke)
            )
        }
        SceneShape::Area { points, fill, stroke } => {
            let stroke = stroke.as_ref().map(line).unwrap_or_default();
            write!(out, "<polygon points=\"{}\"{}{stroke}{more}/>", list(points), filling(fill))
        }
        SceneShape::Circle { centre, radius, fill, stroke } => {
            let stroke = stroke.as_ref().map(line).unwrap_or_default();
            let (x, y, radius) = (number(centre.0), number(centre.1), number(*radius));
            let fill = filling(fill);
            write!(out, "<circle cx=\"{x}\" cy=\"{y}\" r=\"{radius}\"{fill}{stroke}{more}/>")
        }
        SceneShape::Text { at, text, size, weight, color, anchor, direction, rim } => {
            let anchor = match anchor {
                Anchor::Start => "start",
                Anchor::Middle => "middle",
                Anchor::End => "end",
            };
            let (x, y) = (number(at.0), number(at.1));
            let place = match direction {
                Direction::Right => format!("x=\"{x}\" y=\"{y}\""),
                Direction::Up => format!("transform=\"translate({x} {y}) rotate(-90)\""),
            };
            let beneath = |rim| format!("{} paint-order=\"stroke\"", line(rim));
            let rim = rim.as_ref().map(beneath).unwrap_or_default();
            write!(
                out,
                "<text {place} font-size=\"{}\" font-weight=\"{}\" fill=\"{}\" \
                 text-anchor=\"{anchor}\"{rim}{more}>{}</text>",
                number(*size),
                weight.number(),
                hex(*color),
                spans(text, *size)
            )
        }
    };
    written.expect("writing to a string cannot fail");
}

/// The content of a text, with its subscripts lowered.
fn spans(text: &str, size: f64) -> String {
    let mut out = String::new();
    // The drop of the previous letters below the baseline.
    let mut below = 0.0;
    for run in runs(text) {
        let (small, drop) = run.level.size_and_drop(size);
        let words = escaped(run.text);
        match (run.level, drop - below) {
            (Level::Base, 0.0) => out.push_str(&words),
            (Level::Base, down) => {
                let _ = write!(out, "<tspan dy=\"{}\">{words}</tspan>", number(down));
            }
            (Level::Subscript, down) => {
                let (down, small) = (number(down), number(small));
                let _ = write!(out, "<tspan dy=\"{down}\" font-size=\"{small}\">{words}</tspan>");
            }
        }
        below = drop;
    }
    out
}

/// A number with at most two decimals.
pub(crate) fn number(value: f64) -> String {
    let text = format!("{value:.2}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".to_owned() } else { text.to_owned() }
}

/// Text for an element or a double-quoted attribute. Characters that XML cannot contain are replaced.
fn escaped(text: &str) -> String {
    let is_foreign = |character: char| match character {
        '\t' | '\n' => false,
        '\u{fffe}' | '\u{ffff}' => true,
        other => other.is_control(),
    };
    html! { (text.replace(is_foreign, "\u{fffd}")) }.into_string()
}

fn list(points: &[Point]) -> String {
    let point = |(x, y): &Point| format!("{},{}", number(*x), number(*y));
    points.iter().map(point).collect::<Vec<_>>().join(" ")
}

pub(super) fn hex(Color(red, green, blue): Color) -> String {
    format!("#{red:02x}{green:02x}{blue:02x}")
}

fn filling(fill: &Fill) -> String {
    let opacity = match fill.opacity {
        opacity if opacity < 1.0 => format!(" fill-opacity=\"{}\"", number(opacity)),
        _ => String::new(),
    };
    format!(" fill=\"{}\"{opacity}", hex(fill.color))
}

fn line(stroke: &Stroke) -> String {
    let mut text = format!(
        " stroke=\"{}\" stroke-width=\"{}\" stroke-linejoin=\"round\"",
        hex(stroke.color),
        number(stroke.width)
    );
    if let Some((dash, gap)) = stroke.dash {
        let _ = write!(text, " stroke-dasharray=\"{} {}\"", number(dash), number(gap));
    }
    if stroke.opacity < 1.0 {
        let _ = write!(text, " stroke-opacity=\"{}\"", number(stroke.opacity));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hostile_text_is_text() {
        assert_eq!(
            escaped("<script>\"&'</script>\u{1}"),
            "&lt;script&gt;&quot;&amp;'&lt;/script&gt;\u{fffd}"
        );
    }
}
