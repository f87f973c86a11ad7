//! Scenes made from scenes: scaled, and side by side.

use super::{Mark, Point, Scene, SceneShape, Stroke};

impl Scene {
    /// The scene with every length times `factor`.
    pub fn scaled(mut self, factor: f64) -> Scene {
        if factor == 1.0 {
            return self;
        }
        let moved = |(x, y): Point| (x * factor, y * factor);
        self.marks.iter_mut().for_each(|mark| change(&mut mark.shape, &moved, factor));
        Scene { width: self.width * factor, height: self.height * factor, ..self }
    }

    /// The scenes combined in rows of two; their series stay distinct.
    pub fn in_rows(scenes: &[&Scene], description: String) -> Scene {
        const COLUMNS: usize = 2;
        let columns = COLUMNS.min(scenes.len()).max(1);
        let most = |size: fn(&Scene) -> f64| scenes.iter().map(|one| size(one)).fold(0.0, f64::max);
        let (width, height) = (most(|one| one.width), most(|one| one.height));
        let mut all = Scene {
            width: width * columns as f64,
            height: height * scenes.len().div_ceil(columns) as f64,
            description,
            marks: Vec::new(),
            series: Vec::new(),
        };
        for (at, scene) in scenes.iter().enumerate() {
            let left = width * (at % columns) as f64;
            let top = height * (at / columns) as f64;
            let first = all.series.len();
            let placed = scene.marks.iter().map(|mark| {
                let mut mark = mark.clone();
                change(&mut mark.shape, &|(x, y)| (x + left, y + top), 1.0);
                Mark { series: mark.series.map(|series| series + first), ..mark }
            });
            all.marks.extend(placed);
            all.series.extend(scene.series.iter().cloned());
        }
        all
    }
}

/// Moves the points of a shape, and multiplies its other lengths by `factor`.
fn change(shape: &mut SceneShape, moved: &impl Fn(Point) -> Point, factor: f64) {
    let line = |stroke: &mut Stroke| {
        stroke.width *= factor;
        stroke.dash = stroke.dash.map(|(dash, gap)| (dash * factor, gap * factor));
    };
    match shape {
        SceneShape::Line { points, stroke } => {
            points.iter_mut().for_each(|point| *point = moved(*point));
            line(stroke);
        }
        SceneShape::Area { points, stroke, .. } => {
            points.iter_mut().for_each(|point| *point = moved(*point));
            stroke.iter_mut().for_each(line);
        }
        SceneShape::Circle { centre, radius, stroke, .. } => {
            *centre = moved(*centre);
            *radius *= factor;
            stroke.iter_mut().for_each(line);
        }
        SceneShape::Text { at, size, rim, .. } => {
            *at = moved(*at);
            *size *= factor;
            rim.iter_mut().for_each(line);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::scene::Color;

    fn scene(width: f64) -> Scene {
        let stroke = Stroke { dash: Some((2.0, 1.0)), ..Stroke::solid(Color::WHITE, 1.0) };
        let line = Mark::from(SceneShape::Line { points: vec![(1.0, 2.0), (3.0, 4.0)], stroke });
        let description = String::new();
        Scene {
            width,
            height: 10.0,
            description,
            marks: vec![line.of(0)],
            series: vec![Vec::new()],
        }
    }

    #[test]
    fn a_scaled_scene_is_as_large_in_every_length() {
        let twice = scene(20.0).scaled(2.0);
        assert_eq!((twice.width, twice.height), (40.0, 20.0));
        let SceneShape::Line { points, stroke } = &twice.marks[0].shape else { panic!() };
        assert_eq!(*points, [(2.0, 4.0), (6.0, 8.0)]);
        assert_eq!((stroke.width, stroke.dash), (2.0, Some((4.0, 2.0))));
    }

    #[test]
    fn three_scenes_make_two_rows_and_keep_their_series_apart() {
        let scenes = [scene(20.0), scene(30.0), scene(20.0)];
        let all = Scene::in_rows(&scenes.iter().collect::<Vec<_>>(), String::new());
        assert_eq!((all.width, all.height), (60.0, 20.0));
        let first = |mark: &Mark| match &mark.shape {
            SceneShape::Line { points, .. } => points[0],
            other => panic!("{other:?}"),
        };
        let positions: Vec<Point> = all.marks.iter().map(first).collect();
        assert_eq!(positions, [(1.0, 2.0), (31.0, 2.0), (1.0, 12.0)]);
        let series: Vec<_> = all.marks.iter().map(|mark| mark.series).collect();
        assert_eq!(series, [Some(0), Some(1), Some(2)]);
    }
}
