//! The families, each with random form and dimensions in the range of everyday things; one file a subject.

mod bottles;
mod bowls;
mod boxes;
mod cans;
mod compounds;
mod cups;
mod draw;
mod flats;
mod handles;
mod made;
mod plates;
mod pots;
mod rounds;
mod small;
mod tools;
mod toys;

use rand::Rng;

use self::draw::Draw;
use super::ObjectShape;

/// A kind of object.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Family {
    /// A cuboid of board or wood, from a matchbox to a shoe carton.
    Box,
    /// Packaging: thin boxes, gable tops, cartons with a cap.
    Carton,
    /// A plain cylinder, cone or disc.
    Cylinder,
    /// A prism over a polygon, an oval or a rounded rectangle.
    Prism,
    /// A tin or drink can.
    Can,
    /// A round bottle: body, shoulder, neck, cap.
    Bottle,
    /// A bottle of flat cross-section: detergent, shampoo.
    Flask,
    /// A jar with a lid.
    Jar,
    /// A cup with one or two handles.
    Mug,
    /// A cup without one.
    Cup,
    /// A drinking glass, also with a stem.
    Glass,
    /// A bowl.
    Bowl,
    /// A plate, flat or deep.
    Plate,
    /// An open box: tray, basket, storage box.
    Tray,
    /// A pot with two grips, with or without lid.
    Pot,
    /// A pan or saucepan with one long handle.
    Pan,
    /// A tool, lying as it would be put down.
    Tool,
    /// Small household things: soap, dice, tape, fruit, half-balls.
    Small,
    /// Odd shapes of bricks and wedges: letters, steps, arches, tables.
    Compound,
    /// Toys.
    Toy,
    /// What lies flat on a desk: books, notebooks, parcels, laptops, tablets, lids. Only where it is asked for.
    Flat,
}

impl Family {
    /// All families.
    pub const ALL: [Self; 21] = [
        Self::Box,
        Self::Carton,
        Self::Cylinder,
        Self::Prism,
        Self::Can,
        Self::Bottle,
        Self::Flask,
        Self::Jar,
        Self::Mug,
        Self::Cup,
        Self::Glass,
        Self::Bowl,
        Self::Plate,
        Self::Tray,
        Self::Pot,
        Self::Pan,
        Self::Tool,
        Self::Small,
        Self::Compound,
        Self::Toy,
        Self::Flat,
    ];

    /// The lower-case name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Box => "box",
            Self::Carton => "carton",
            Self::Cylinder => "cylinder",
            Self::Prism => "prism",
            Self::Can => "can",
            Self::Bottle => "bottle",
            Self::Flask => "flask",
            Self::Jar => "jar",
            Self::Mug => "mug",
            Self::Cup => "cup",
            Self::Glass => "glass",
            Self::Bowl => "bowl",
            Self::Plate => "plate",
            Self::Tray => "tray",
            Self::Pot => "pot",
            Self::Pan => "pan",
            Self::Tool => "tool",
            Self::Small => "small",
            Self::Compound => "compound",
            Self::Toy => "toy",
            Self::Flat => "flat",
        }
    }

    /// A random object of this family, named more closely where the family is wide (a [`Family::Tool`] says `hammer`). `scale` multiplies
    /// its usual size (1 for a household's variety, less for small hands).
    pub fn sample(self, scale: f32, rng: &mut impl Rng) -> ObjectShape {
        let mut draw = Draw::new(scale, rng);
        let draw = &mut draw;
        let made = match self {
            Self::Box => boxes::cuboid(draw),
            Self::Carton => boxes::carton(draw),
            Self::Cylinder => rounds::cylinder(draw),
            Self::Prism => rounds::prism(draw),
            Self::Can => cans::can(draw),
            Self::Bottle => bottles::bottle(draw),
            Self::Flask => bottles::flask(draw),
            Self::Jar => bottles::jar(draw),
            Self::Mug => cups::mug(draw),
            Self::Cup => cups::cup(draw),
            Self::Glass => cups::glass(draw),
            Self::Bowl => bowls::bowl(draw),
            Self::Plate => plates::plate(draw),
            Self::Tray => plates::tray(draw),
            Self::Pot => pots::pot(draw),
            Self::Pan => pots::pan(draw),
            Self::Tool => tools::tool(draw),
            Self::Small => small::small(draw),
            Self::Compound => compounds::compound(draw),
            Self::Toy => toys::toy(draw),
            Self::Flat => flats::flat(draw),
        };
        made.shape(draw)
    }
}
