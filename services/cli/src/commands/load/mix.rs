//! What is asked: one kind of request, or a mix of several, each with a share. Which one a request is follows from the seed.

use std::str::FromStr;

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use repose_proto::Priority;
use repose_proto::place::Variant;

use crate::values::parse_variant;

/// What a request calls.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Method {
    /// A placement, of the planner.
    Place,
    /// An arrangement of two objects, of the planner.
    Arrange,
    /// A frame into a scene, of perception: the camera's newest frame, sent whole.
    Segment,
}

impl Method {
    const ALL: [Self; 3] = [Self::Place, Self::Arrange, Self::Segment];

    /// Its name on the wire.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Place => "place",
            Self::Arrange => "arrange",
            Self::Segment => "segment",
        }
    }
}

/// One kind of request. What it leaves open is the run's (`--variant`, `--deadline-ms`, `--interactive`, `--cell`, …).
#[derive(Debug, Clone, PartialEq)]
pub struct Kind {
    /// What the report calls it: what it was made of.
    pub name: String,
    share: f64,
    /// What it calls.
    pub method: Method,
    /// How a placement is searched for.
    pub variant: Option<Variant>,
    /// Placements wanted.
    pub count: Option<u32>,
    /// Iterations of the search.
    pub iterations: Option<u32>,
    /// Candidates of an iteration.
    pub batch: Option<u32>,
    /// Whether somebody waits for it.
    pub priority: Option<Priority>,
    /// Its deadline, milliseconds.
    pub deadline_ms: Option<u64>,
    /// Its cell.
    pub cell: Option<String>,
    /// Whether it encloses its scene, megabytes, from the start.
    pub is_whole: bool,
}

impl Default for Kind {
    fn default() -> Self {
        Self {
            name: Method::Place.as_str().to_owned(),
            share: 1.0,
            method: Method::Place,
            variant: None,
            count: None,
            iterations: None,
            batch: None,
            priority: None,
            deadline_ms: None,
            cell: None,
            is_whole: false,
        }
    }
}

/// The settings of a kind, for errors.
const SETTINGS: &str = "method, variant, count, iterations, batch, priority, deadline_ms, cell, whole";

impl FromStr for Kind {
    type Err = String;

    /// `3:variant=full,count=2`: a share, and after the colon settings.
    fn from_str(text: &str) -> Result<Self, String> {
        let (share, settings) = text.split_once(':').unwrap_or((text, ""));
        let share = share.trim().parse::<f64>().ok().filter(|share| share.is_finite() && *share > 0.0);
        let share = share.ok_or_else(|| format!("expected SHARE:SETTING=VALUE,…, such as 3:variant=full,count=2, got {text:?}"))?;
        let mut kind = Self { share, ..Self::default() };
        for setting in settings.split(',').map(str::trim).filter(|setting| !setting.is_empty()) {
            let (name, value) = setting.split_once('=').ok_or_else(|| format!("expected SETTING=VALUE, got {setting:?}"))?;
            kind.set(name.trim(), value.trim())?;
        }
        if let Some(setting) = kind.unheeded() {
            return Err(format!("{setting}: {} takes no such setting", kind.method.as_str()));
        }
        if !settings.trim().is_empty() {
            kind.name = settings.trim().to_owned();
        }
        Ok(kind)
    }
}

impl Kind {
    /// The same, asked in a cell.
    pub fn in_cell(&self, cell: String) -> Self {
        Self { name: format!("{},cell={cell}", self.name), cell: Some(cell), ..self.clone() }
    }

    /// A setting that was given, and that its method does not take.
    fn unheeded(&self) -> Option<&'static str> {
        let of_scenes = [("variant", self.variant.is_some()), ("whole", self.is_whole)];
        let of_placements = [("count", self.count.is_some()), ("iterations", self.iterations.is_some()), ("batch", self.batch.is_some())];
        let unheeded = match self.method {
            Method::Place => Vec::new(),
            Method::Arrange => of_placements.to_vec(),
            Method::Segment => [&of_scenes[..], &of_placements].concat(),
        };
        unheeded.into_iter().find(|(_, is_given)| *is_given).map(|(setting, _)| setting)
    }

    fn set(&mut self, name: &str, value: &str) -> Result<(), String> {
        fn number<T: FromStr>(name: &str, value: &str) -> Result<Option<T>, String> {
            value.parse().map(Some).map_err(|_| format!("{name}: expected a number, got {value:?}"))
        }
        let one_of = |known: &str| format!("{name}: expected {known}, got {value:?}");
        match name {
            "method" => {
                let found = Method::ALL.into_iter().find(|method| method.as_str() == value);
                self.method = found.ok_or_else(|| one_of("place, arrange or segment"))?;
            }
            "variant" => self.variant = Some(parse_variant(value)?),
            "count" => self.count = number(name, value)?,
            "iterations" => self.iterations = number(name, value)?,
            "batch" => self.batch = number(name, value)?,
            "deadline_ms" => self.deadline_ms = number(name, value)?,
            "cell" => self.cell = Some(value.to_owned()),
            "priority" => {
                self.priority = Some(match value {
                    "interactive" => Priority::Interactive,
                    "batch" => Priority::Batch,
                    _ => return Err(one_of("interactive or batch")),
                });
            }
            "whole" => self.is_whole = value.parse().map_err(|_| one_of("true or false"))?,
            _ => return Err(format!("{name}: there is no such setting, there are {SETTINGS}")),
        }
        Ok(())
    }
}

/// The kind of the `i`-th request: each as often as its share says, the same for the same seed.
pub fn kind_of(kinds: &[Kind], seed: u64, i: usize) -> usize {
    let whole: f64 = kinds.iter().map(|kind| kind.share).sum();
    let drawn: f64 = Pcg64::seed_from_u64(seed.rotate_left(32) ^ (i as u64).wrapping_mul(0xd134_2543_de82_ef95)).random();
    let mut left = drawn * whole;
    let chosen = kinds.iter().position(|kind| {
        left -= kind.share;
        left < 0.0
    });
    chosen.unwrap_or(kinds.len().saturating_sub(1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_kind_is_read_with_its_share_and_what_is_wrong_with_one_is_said() {
        let kind: Kind = "3:variant=full,count=2,priority=batch,deadline_ms=5000,whole=true".parse().expect("a kind");
        assert_eq!((kind.share, kind.method, kind.count), (3.0, Method::Place, Some(2)));
        assert_eq!(
            (kind.variant, kind.priority, kind.deadline_ms, kind.is_whole),
            (Some(Variant::Full), Some(Priority::Batch), Some(5000), true)
        );
        assert_eq!("1".parse::<Kind>().map(|kind| kind.name), Ok("place".to_owned()));
        for (wrong, named) in [
            ("many:count=2", "SHARE"),
            ("0:count=2", "SHARE"),
            ("1:count=two", "count"),
            ("1:method=move", "arrange"),
            ("1:sise=2", "sise"),
            ("1:count", "VALUE"),
            ("1:count=2,method=arrange", "count: arrange takes"),
            ("1:method=segment,whole=true", "whole: segment takes"),
        ] {
            assert!(wrong.parse::<Kind>().is_err_and(|error| error.contains(named)), "{wrong}");
        }
    }

    #[test]
    fn shares_are_kept_and_follow_from_the_seed() {
        let kinds: Vec<Kind> = ["3:count=1", "1:count=2"].iter().map(|text| text.parse().expect("a kind")).collect();
        let second = (0..10_000).filter(|i| kind_of(&kinds, 5, *i) == 1).count();
        assert!((2350..2650).contains(&second), "{second}");
        assert!((0..100).all(|i| kind_of(&kinds, 5, i) == kind_of(&kinds, 5, i)));
        assert!((0..100).any(|i| kind_of(&kinds, 5, i) != kind_of(&kinds, 6, i)));
    }
}
