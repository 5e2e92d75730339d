//! How objects are put into a scene: how many, which, how large, and in what ways.

use nalgebra::Point2;

use crate::furniture::SceneKind;
use crate::objects::{Family, ObjectSource};

/// How scenes are arranged.
#[derive(Debug, Clone, PartialEq)]
pub struct ArrangeSettings {
    /// Fewest and most objects.
    pub objects: [usize; 2],
    /// Where objects are drawn from.
    pub source: ObjectSource,
    /// Smallest and largest scale of an object's usual size.
    pub scale: [f32; 2],
    /// Half the edge of the square within which objects are put on a surface, lowest and highest, metres.
    pub spread_m: [f64; 2],
    /// Where the objects gather, world; anywhere on the furniture by default.
    pub gather_at: Option<Point2<f64>>,
    /// How likely they gather at the edge of the furniture, where that is left to chance.
    pub at_edge: f64,
    /// How likely an object on which nothing can stand is drawn anew.
    pub stackable: f64,
    /// Highest that something may be over its surface for another to be put on top of it, metres.
    pub highest_stack_m: f64,
    /// Lowest and highest friction coefficient of an object of which nobody has said it.
    pub friction: [f32; 2],
    /// How likely each way of placing an object is; need not sum to 1.
    pub ways: Ways,
    /// How likely an object on a surface lies on its side or upside down.
    pub lying: f64,
    /// How likely a stacked object stands centred on the other.
    pub centered: f64,
    /// How likely an object beside another touches it.
    pub touching: f64,
    /// How likely an object takes over the orientation of the one it stands by.
    pub aligned: f64,
    /// How likely what goes on top goes on the highest stack so far.
    pub tower: f64,
}

/// Weights of the ways to place an object.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ways {
    /// Somewhere on a surface.
    pub surface: f64,
    /// Beside an object.
    pub beside: f64,
    /// On top of an object.
    pub on_top: f64,
    /// Into a vessel.
    pub into: f64,
    /// Falling, in any orientation.
    pub falling: f64,
}

/// Most objects on top of each other.
pub const MOST_STACKED: usize = 4;

impl Default for ArrangeSettings {
    fn default() -> Self {
        Self {
            objects: [3, 7],
            source: ObjectSource::default(),
            scale: [0.75, 1.25],
            spread_m: [0.14, 0.3],
            gather_at: None,
            at_edge: 0.2,
            stackable: 0.0,
            highest_stack_m: 0.28,
            friction: [0.45, 0.9],
            ways: Ways { surface: 0.32, beside: 0.22, on_top: 0.32, into: 0.04, falling: 0.1 },
            lying: 0.2,
            centered: 0.75,
            touching: 0.6,
            aligned: 0.6,
            tower: 0.0,
        }
    }
}

impl ArrangeSettings {
    /// The settings for a kind of scene: what the kind is about comes on top of what was asked for.
    pub fn for_kind(&self, kind: SceneKind) -> Self {
        let mut settings = self.clone();
        let ways = &mut settings.ways;
        match kind {
            SceneKind::OpenTable | SceneKind::LargeBox => {}
            SceneKind::Clutter => {
                settings.objects = [self.objects[1]; 2];
                settings.spread_m = self.spread_m.map(|s| s * 0.55);
                // Packed so closely at an edge, every other draw would lose something.
                settings.at_edge = self.at_edge * 0.3;
                *ways = Ways { surface: 0.3, beside: 0.42, on_top: 0.15, into: 0.05, falling: 0.08 };
            }
            SceneKind::Stacking => {
                *ways = Ways { surface: 0.3, beside: 0.05, on_top: 0.6, into: 0.05, falling: 0.0 };
                settings.highest_stack_m = self.highest_stack_m.max(0.35);
                settings.tower = 0.6;
                settings.stackable = 0.5;
            }
            // Wider: a board is long and the objects are shared out between two levels. Nothing falls into a shelf.
            SceneKind::Shelf => {
                settings.spread_m = self.spread_m.map(|s| s * 1.2);
                ways.falling = 0.0;
            }
            SceneKind::Desk => {
                settings.objects = [8, 25];
                settings.source = self.source.clone().with_family(Family::Flat, 1.0 / 3.0);
                settings.spread_m = [0.25, 0.5];
                settings.at_edge = self.at_edge * 0.3;
                settings.stackable = 0.5;
                *ways = Ways { surface: 0.45, beside: 0.3, on_top: 0.2, into: 0.03, falling: 0.02 };
            }
            SceneKind::Pile => {
                settings.objects = [8, 25];
                settings.source = self.source.clone().with_family(Family::Flat, 0.3);
                settings.scale = [self.scale[0] * 0.8, self.scale[1]];
                settings.spread_m = [0.12, 0.32];
                settings.at_edge = self.at_edge * 0.2;
                settings.lying = self.lying.max(0.3);
                settings.stackable = 0.3;
                *ways = Ways { surface: 0.24, beside: 0.34, on_top: 0.22, into: 0.03, falling: 0.17 };
            }
            SceneKind::Drawer | SceneKind::Kitchen => settings.lying = self.lying.max(0.3),
        }
        settings
    }
}
