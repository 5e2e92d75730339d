//! Where a scene's objects come from: the procedural families, a folder of meshes, or both.

use std::sync::Arc;

use rand::{Rng, RngExt};

use super::meshes::MeshLibrary;
use super::{Family, ObjectShape};

/// Where objects are drawn from. With the same generator state the same object comes.
#[derive(Debug, Clone, PartialEq)]
pub struct ObjectSource {
    /// Families with their weights; need not sum to 1.
    families: Vec<(Family, f64)>,
    /// Meshes, all alike likely, and how likely one of them comes instead of a family.
    meshes: Option<(MeshLibrary, f64)>,
}

impl ObjectSource {
    /// Families with weights (at least one above 0; need not sum to 1). Without any, all families alike.
    pub fn procedural(families: impl IntoIterator<Item = (Family, f64)>) -> Self {
        let mut families: Vec<(Family, f64)> = families.into_iter().filter(|(_, weight)| *weight > 0.0).collect();
        if families.is_empty() {
            families = Family::ALL.map(|family| (family, 1.0)).to_vec();
        }
        Self { families, meshes: None }
    }

    /// Only meshes.
    pub fn meshes(library: MeshLibrary) -> Self {
        Self::procedural([]).with_meshes(library, 1.0)
    }

    /// These families, and with probability `share` (0 to 1) a mesh instead.
    #[must_use]
    pub fn with_meshes(self, library: MeshLibrary, share: f64) -> Self {
        Self { meshes: Some((library, share.clamp(0.0, 1.0))), ..self }
    }

    /// The same with another family at a share (0 to 1) of those objects that are no meshes.
    #[must_use]
    pub fn with_family(mut self, family: Family, share: f64) -> Self {
        self.families.retain(|(other, _)| *other != family);
        let others: f64 = self.families.iter().map(|(_, weight)| weight).sum();
        let share = share.clamp(0.0, 0.999);
        self.families.push((family, share / (1.0 - share) * others.max(f64::MIN_POSITIVE)));
        self
    }

    /// Draws an object. `scale` multiplies a family's usual size; meshes keep theirs.
    pub fn sample(&self, scale: f32, rng: &mut impl Rng) -> Arc<ObjectShape> {
        if let Some((library, share)) = &self.meshes
            && rng.random_bool(*share)
        {
            let shapes = library.shapes();
            return shapes[rng.random_range(0..shapes.len())].clone();
        }
        let mut ticket = rng.random_range(0.0..self.families.iter().map(|(_, weight)| weight).sum::<f64>());
        let drawn = self.families.iter().find(|(_, weight)| {
            ticket -= weight;
            ticket < 0.0
        });
        // Rounding may leave the last ticket over.
        let (family, _) = drawn.unwrap_or(&self.families[self.families.len() - 1]);
        Arc::new(family.sample(scale, rng))
    }
}

impl Default for ObjectSource {
    /// All families as often as on tables: boxes, bottles and cups more, the odd things less.
    fn default() -> Self {
        let weight = |family: Family| match family {
            Family::Box => 4.0,
            Family::Carton | Family::Mug | Family::Bowl | Family::Bottle => 2.0,
            // Scenes that were made before it came stay what they are.
            Family::Flat => 0.0,
            Family::Glass | Family::Flask | Family::Pan | Family::Tray | Family::Toy => 0.8,
            Family::Cylinder
            | Family::Prism
            | Family::Can
            | Family::Jar
            | Family::Cup
            | Family::Plate
            | Family::Pot
            | Family::Tool
            | Family::Small
            | Family::Compound => 1.2,
        };
        Self::procedural(Family::ALL.map(|family| (family, weight(family))))
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_pcg::Pcg64;

    use super::*;

    #[test]
    fn families_come_as_often_as_their_weights_say_and_the_same_seed_gives_the_same() {
        let source = ObjectSource::procedural([(Family::Plate, 3.0), (Family::Can, 1.0), (Family::Toy, 0.0)]);
        let draw = || {
            let mut rng = Pcg64::seed_from_u64(1);
            (0..400).map(|_| source.sample(1.0, &mut rng).name.to_string()).collect::<Vec<_>>()
        };
        let names = draw();
        let plates = names.iter().filter(|n| *n == "plate").count();
        assert!((260..340).contains(&plates), "{plates} of 400");
        assert!(names.iter().all(|n| n == "plate" || n == "can"));
        assert_eq!(names, draw());
    }
}
