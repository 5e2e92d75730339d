//! Which object carries which: by rule where enough of a base is over a top ([`crate::standing`]), and else where it is likely enough by all that
//! was seen of both ([`crate::bearing`]).

use std::collections::BTreeMap;

use crate::bearing::{Bearing, Candidate};
use crate::shape::Shape;
use crate::standing::{ObservedGeometry, is_on};

/// Which objects each object carries, by its id: those that stand on it or in it, also if they stand on others besides; `pairs` are those of which one
/// may bear the other. Objects that carry nothing are left out.
pub fn carried_by(seen: &ObservedGeometry<'_>, shapes: &BTreeMap<u16, Shape>, pairs: &[Candidate]) -> BTreeMap<u16, Vec<u16>> {
    let settings = &seen.settings.stack;
    let mut carried: BTreeMap<u16, Vec<u16>> = BTreeMap::new();
    for (carrier, below) in shapes {
        let above = shapes.iter().filter(|(id, above)| *id != carrier && is_on(above, below, seen.columns, settings));
        carried.entry(*carrier).or_default().extend(above.map(|(id, _)| *id));
    }
    for pair in pairs {
        let loads = carried.entry(pair.carrier).or_default();
        if !loads.contains(&pair.load) && Bearing::own().probability(&pair.measures) >= settings.carried_probability {
            loads.push(pair.load);
        }
    }
    carried.retain(|_, loads| !loads.is_empty());
    carried.values_mut().for_each(|loads| loads.sort_unstable());
    carried
}
