//! The features of the outcome.

/// A feature of the outcome.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Feature {
    /// 0 in the morning, 1 in the evening.
    TimeOfDay,
    /// The two brushings of the day before, normalised.
    Previous,
    /// The average of brushing, normalised.
    Brushing,
    /// The average of prompts, normalised.
    Dosage,
    /// Whether the app was opened on the day before.
    App,
    /// The day in the study, normalised.
    Day,
    /// The share of the last 14 decisions with any brushing.
    BrushedShare,
    /// 1 on two days of every week.
    Weekend,
    /// 1.
    One,
}

/// The number of features.
pub(super) const FEATURES: usize = Feature::ALL.len();

/// One number per feature.
pub(super) type Weights = [f64; FEATURES];

impl Feature {
    /// Every feature, in the order of weights.
    pub(super) const ALL: [Feature; 9] = [
        Feature::TimeOfDay,
        Feature::Previous,
        Feature::Brushing,
        Feature::Dosage,
        Feature::App,
        Feature::Day,
        Feature::BrushedShare,
        Feature::Weekend,
        Feature::One,
    ];

    /// The end of the names of columns in a file of people.
    pub(super) fn column(self) -> &'static str {
        match self {
            Feature::TimeOfDay => "tod",
            Feature::Previous => "prev",
            Feature::Brushing => "b",
            Feature::Dosage => "a",
            Feature::App => "app",
            Feature::Day => "day",
            Feature::BrushedShare => "prop",
            Feature::Weekend => "weekend",
            Feature::One => "one",
        }
    }
}
