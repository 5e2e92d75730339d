//! What things are made of: density, friction, and how a mass follows from a shape.
//!
//! Densities are those of engineering handbooks (steel 7.85, aluminium 2.7, stoneware 2.2 to 2.5, soda-lime glass 2.5, polyethylene and
//! polypropylene 0.9 to 0.97, PET 1.38, board 0.6 to 0.8, dry hard and soft woods 0.4 to 0.75 g/cm³). Friction is what a contact with a
//! laminate or wooden table (0.6 here) should have as the mean of the two: tables of dry static friction give wood on wood 0.25 to 0.5,
//! steel on wood 0.2 to 0.6, glass on wood about 0.4 to 0.6, plastics on wood and metal 0.2 to 0.4, paper and board on wood 0.3 to 0.5,
//! rubber on solids 0.6 to 0.9; glazed ceramics lie with glass. The coefficients below are twice that less the table's, kept above 0.2.

/// A material.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Material {
    /// Steel of pots and tools.
    Steel,
    /// Aluminium and tinplate of cans and light pans.
    Aluminium,
    /// Stoneware and porcelain.
    Ceramic,
    /// Soda-lime glass.
    Glass,
    /// Polyethylene, polypropylene, PET, ABS.
    Plastic,
    /// Board and paper.
    Cardboard,
    /// Dry wood.
    Wood,
    /// Rubber and foam.
    Rubber,
}

impl Material {
    /// Lowest and highest density, kg/m³.
    pub fn density_kg_m3(self) -> [f32; 2] {
        match self {
            Self::Steel => [7700.0, 7900.0],
            Self::Aluminium => [2650.0, 2750.0],
            Self::Ceramic => [2150.0, 2500.0],
            Self::Glass => [2400.0, 2550.0],
            Self::Plastic => [900.0, 1380.0],
            Self::Cardboard => [600.0, 800.0],
            Self::Wood => [400.0, 750.0],
            Self::Rubber => [150.0, 1200.0],
        }
    }

    /// Lowest and highest friction coefficient; a contact takes the mean of the two that touch.
    pub fn friction(self) -> [f32; 2] {
        match self {
            Self::Steel => [0.3, 0.6],
            Self::Aluminium => [0.3, 0.6],
            Self::Ceramic => [0.35, 0.65],
            Self::Glass => [0.35, 0.65],
            Self::Plastic => [0.25, 0.5],
            Self::Cardboard => [0.35, 0.6],
            Self::Wood => [0.35, 0.6],
            Self::Rubber => [0.7, 1.1],
        }
    }
}

/// How the mass follows from the shape.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Mass {
    /// Of the material all through.
    Solid,
    /// A closed skin of the material, of this thickness (metres), around `content_kg_m3` of contents per enclosed volume (0: empty).
    Filled {
        /// Thickness of the skin, metres.
        skin_m: f32,
        /// Bulk density of what is inside, averaged over the enclosed volume.
        content_kg_m3: f32,
    },
}

impl Mass {
    /// The least and the greatest mass of an object. Below 30 g the engine's contacts chatter under a load fifty times as heavy, and
    /// what weighs more than 1.5 kg neither a hand's friction grasp lifts nor a stack of light things bears; both are rare on tables.
    pub const LIMITS_KG: [f32; 2] = [0.03, 1.5];

    /// The mass of an object, kilograms: its material's density (kg/m³), the volume its surface encloses (m³) and the surface's area (m²).
    pub fn of(self, density_kg_m3: f32, volume_m3: f32, area_m2: f32) -> f32 {
        let mass = match self {
            Self::Solid => volume_m3 * density_kg_m3,
            Self::Filled { skin_m, content_kg_m3 } => {
                let skin_m3 = (area_m2 * skin_m).min(volume_m3);
                skin_m3 * density_kg_m3 + (volume_m3 - skin_m3) * content_kg_m3
            }
        };
        mass.clamp(Self::LIMITS_KG[0], Self::LIMITS_KG[1])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_litre_of_water_in_a_thin_skin_weighs_a_kilogram_and_a_feather_the_least_allowed() {
        let bottle = Mass::Filled { skin_m: 0.0005, content_kg_m3: 1000.0 }.of(1300.0, 0.001, 0.06);
        assert!((bottle - 1.009).abs() < 0.001, "{bottle}");
        assert_eq!(Mass::Solid.of(100.0, 1e-6, 1e-4), Mass::LIMITS_KG[0]);
        assert_eq!(Mass::Solid.of(7800.0, 1e-3, 0.06), Mass::LIMITS_KG[1]);
    }
}
