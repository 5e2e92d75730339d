//! Colors of things.

use rand::{Rng, RngExt};

/// A random color of medium to high brightness, so that shading shows.
pub fn random_color(rng: &mut impl Rng) -> [u8; 3] {
    let (hue, saturation, value) = (rng.random_range(0.0..6.0f32), rng.random_range(0.25..0.85f32), rng.random_range(0.6..0.98f32));
    let channel = |shift: f32| {
        let k = (shift + hue) % 6.0;
        (value * (1.0 - saturation * k.min(4.0 - k).clamp(0.0, 1.0)) * 255.0) as u8
    };
    [channel(5.0), channel(3.0), channel(1.0)]
}
