//! The people of an environment, from the rows of its file.

use std::fmt;

use crate::env::oralytics::feature::{FEATURES, Feature, Weights};
use crate::env::oralytics::parameters::{EffectSize, TestBed};
use crate::env::oralytics::person::Person;
use crate::env::oralytics::table::{Table, column};

/// Why a file does not suit an environment.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Unsuitable(String);

impl fmt::Display for Unsuitable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl Table {
    /// Whether outcomes depend on the day in the study.
    fn has_day(&self) -> bool {
        self.columns.iter().any(|name| name.ends_with(&column("", Feature::Day)))
    }

    /// The people as an environment needs them, in the order of the file.
    ///
    /// **Errors**: a column is missing, or a person has no number in it.
    pub fn people(
        &self,
        (test_bed, stationary, effect_size): (TestBed, bool, EffectSize),
    ) -> Result<Vec<Person>, Unsuitable> {
        let unsuitable = |says: String| Unsuitable(says);
        if self.has_day() == stationary {
            let (has, needs) = if stationary { ("has", "true") } else { ("has no", "false") };
            return Err(unsuitable(format!(
                "it {has} weights of the day, and stationary = {needs}"
            )));
        }
        let effect = match (test_bed, effect_size) {
            (TestBed::V3 | TestBed::V4, _) => "effect",
            (TestBed::V2, EffectSize::Small) => "effect_small",
            (TestBed::V2, EffectSize::Smaller) => "effect_smaller",
        };
        let with_day = |feature: &Feature| *feature != Feature::Day || !stationary;
        let of_outcome: Vec<Feature> =
            features(test_bed).iter().copied().filter(with_day).collect();
        let of_effect = of_outcome.iter().copied();
        let of_effect: Vec<Feature> =
            of_effect.filter(|feature| *feature != Feature::BrushedShare).collect();
        let needed = |person: usize, name: String| {
            let missing =
                || unsuitable(format!("person {} has no number in column `{name}`", person + 1));
            self.number(person, &name).ok_or_else(missing)
        };
        let weights = |person: usize, prefix: &str, shown: &[Feature]| {
            let mut weights: Weights = [0.0; FEATURES];
            for feature in shown {
                weights[*feature as usize] = needed(person, column(prefix, *feature))?;
            }
            Ok(weights)
        };
        let person = |person: usize| {
            Ok(Person {
                sigma: match (test_bed, self.squares[person]) {
                    (TestBed::V3 | TestBed::V4, _) | (TestBed::V2, Some(false)) => None,
                    (TestBed::V2, Some(true)) => Some(needed(person, "sigma".to_owned())?),
                    (TestBed::V2, None) => {
                        return Err(unsuitable(format!("person {} has no `model`", person + 1)));
                    }
                },
                opens_app: match test_bed {
                    TestBed::V2 => OPENS_APP,
                    TestBed::V3 | TestBed::V4 => needed(person, "app_open_probability".to_owned())?,
                },
                bernoulli: weights(person, "bernoulli", &of_outcome)?,
                amount: weights(person, "amount", &of_outcome)?,
                bernoulli_effect: weights(person, &format!("{effect}_bernoulli"), &of_effect)?,
                amount_effect: weights(person, &format!("{effect}_amount"), &of_effect)?,
            })
        };
        (0..self.squares.len()).map(person).collect()
    }
}

/// The probability of opening the app on a day in V2.
const OPENS_APP: f64 = 0.7;

/// The features of the outcome in a test bed, the day included.
fn features(test_bed: TestBed) -> &'static [Feature] {
    match test_bed {
        TestBed::V2 => &[
            Feature::TimeOfDay,
            Feature::Previous,
            Feature::Day,
            Feature::BrushedShare,
            Feature::Weekend,
            Feature::One,
        ],
        TestBed::V3 | TestBed::V4 => &[
            Feature::TimeOfDay,
            Feature::Brushing,
            Feature::Dosage,
            Feature::App,
            Feature::Weekend,
            Feature::One,
            Feature::Day,
        ],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const V2: &str = "person,model,sigma,bernoulli_tod,bernoulli_prev,bernoulli_prop,bernoulli_weekend,\
        bernoulli_one,amount_tod,amount_prev,amount_prop,amount_weekend,amount_one,effect_small_bernoulli_tod,\
        effect_small_bernoulli_prev,effect_small_bernoulli_weekend,effect_small_bernoulli_one,\
        effect_small_amount_tod,effect_small_amount_prev,effect_small_amount_weekend,effect_small_amount_one\n";

    const STATIONARY: (TestBed, bool, EffectSize) = (TestBed::V2, true, EffectSize::Small);
    const WEIGHTS: &str = "1,2,3,4,5,6,7,8,9,10,11,12,13,14,15,16,17,18";

    #[test]
    fn weights_have_the_places_of_their_features() {
        let text = format!("{V2}robas,sqrt_norm,1.5,{WEIGHTS}\n");
        let people = Table::parse(&text).unwrap().people(STATIONARY).unwrap();
        let person = &people[0];
        assert_eq!((person.sigma, person.opens_app), (Some(1.5), 0.7));
        assert_eq!(person.bernoulli[Feature::BrushedShare as usize], 3.0);
        assert_eq!(person.amount[Feature::One as usize], 10.0);
        assert_eq!(person.bernoulli_effect[Feature::Weekend as usize], 13.0);
        assert_eq!(person.amount_effect[Feature::Previous as usize], 16.0);
        assert_eq!(person.amount_effect[Feature::BrushedShare as usize], 0.0);
    }

    #[test]
    fn faults_name_line_and_column() {
        let fault = |text: &str| Table::parse(text).unwrap_err();
        assert!(fault("person,weight\n0,1\n").starts_with("there is no column `weight`"));
        assert_eq!(fault("person,sigma\n"), "expected at least one person");
        assert_eq!(fault("person,sigma\n0,-1\n"), "line 2: `sigma`: -1 is out of range");
        assert!(
            fault("person,model\n0,normal\n").starts_with("line 2: `model`: expected zero_infl")
        );
        assert!(fault("person,sigma\n0\n").contains("line 2"));
        let unsuitable = |line: &str, of| {
            let table = Table::parse(&format!("{V2}{line},{WEIGHTS}\n")).unwrap();
            table.people(of).unwrap_err().to_string()
        };
        let (bed, _, small) = STATIONARY;
        let no_sigma = "person 1 has no number in column `sigma`";
        assert_eq!(unsuitable("0,sqrt_norm,", STATIONARY), no_sigma);
        assert_eq!(unsuitable("0,,1", STATIONARY), "person 1 has no `model`");
        let smaller = unsuitable("0,zero_infl,", (bed, true, EffectSize::Smaller));
        assert!(smaller.contains("`effect_smaller_bernoulli_tod`"), "{smaller}");
        let daily = unsuitable("0,zero_infl,", (bed, false, small));
        assert_eq!(daily, "it has no weights of the day, and stationary = false");
        assert!(unsuitable("0,zero_infl,", (TestBed::V3, true, small)).contains("column"));
    }
}
