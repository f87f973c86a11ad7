//! The legend of an experiment, with which a reader hides arms in all of its figures at once.

use std::collections::{HashMap, HashSet};

use super::figure::Looks;
use super::scene::{Color, Facets, Scene};

/// The values of each facet that the experiment's figures distinguish.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Legend {
    /// Names of facets with their values, each in order of first appearance.
    pub facets: Vec<(String, Vec<LegendValue>)>,
    /// The indices of each facet and of its value.
    indices: HashMap<(String, String), (usize, usize)>,
}

/// A value of a facet.
#[derive(Clone, Debug, PartialEq)]
pub struct LegendValue {
    /// The value as displayed in figures.
    pub value: String,
    /// Its colour, if it has the same colour in all figures.
    pub color: Option<Color>,
}

impl Legend {
    /// The legend of these figures. Facets with a single value offer no choice and are left out.
    pub fn of<'s>(scenes: impl Iterator<Item = &'s (String, Scene)>, looks: &Looks) -> Legend {
        let mut legend = Legend::default();
        let mut seen = HashSet::new();
        let all = scenes.flat_map(|(_, scene)| &scene.series).flatten();
        for (name, value) in all.filter(|facet| seen.insert(*facet)) {
            let index = legend.facets.iter().position(|(known, _)| known == name);
            let index = index.unwrap_or_else(|| {
                legend.facets.push((name.clone(), Vec::new()));
                legend.facets.len() - 1
            });
            let color = looks.color_of(name, value);
            legend.facets[index].1.push(LegendValue { value: value.clone(), color });
        }
        legend.facets.retain(|(_, values)| values.len() > 1);
        let facets = legend.facets.iter().enumerate();
        let indices = facets.flat_map(|(facet, (name, values))| {
            let values = values.iter().enumerate();
            values.map(move |(at, one)| ((name.clone(), one.value.clone()), (facet, at)))
        });
        legend.indices = indices.collect();
        legend
    }

    /// The CSS class of a value, which is unique within an experiment of the page.
    pub fn class(&self, facet: usize, value: usize) -> String {
        format!("f{facet}v{value}")
    }

    /// The CSS classes of a series of marks.
    pub fn classes(&self, series: &Facets) -> String {
        let find_class = |facet: &(String, String)| {
            let (facet, value) = self.indices.get(facet)?;
            Some(self.class(*facet, *value))
        };
        series.iter().filter_map(find_class).collect::<Vec<_>>().join(" ")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_legend_has_what_differs_and_a_series_its_classes() {
        let facets = |list: &[(&str, &str)]| -> Facets {
            list.iter().map(|(name, value)| ((*name).to_owned(), (*value).to_owned())).collect()
        };
        let one = facets(&[("agent", "dqn"), ("scenario", "P"), ("σ", "1")]);
        let two = facets(&[("agent", "dqn"), ("scenario", "L"), ("σ", "2")]);
        let series = vec![one.clone(), two.clone(), facets(&[("scenario", "P")])];
        let (description, marks) = (String::new(), Vec::new());
        let scene = Scene { width: 1.0, height: 1.0, description, marks, series };
        let legend = Legend::of([(String::new(), scene)].iter(), &Looks::default());
        let names: Vec<&str> = legend.facets.iter().map(|(name, _)| name.as_str()).collect();
        assert_eq!(names, ["scenario", "σ"]);
        assert_eq!(legend.classes(&one), "f0v0 f1v0");
        assert_eq!(legend.classes(&two), "f0v1 f1v1");
        assert_eq!(legend.classes(&Facets::new()), "");
    }
}
