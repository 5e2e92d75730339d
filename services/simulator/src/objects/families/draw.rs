//! Random dimensions at a scale.

use rand::{Rng, RngExt};

/// Draws dimensions; lengths are multiplied by the object's scale.
pub struct Draw<'a> {
    scale: f32,
    rng: &'a mut dyn Rng,
}

impl<'a> Draw<'a> {
    /// Draws at a scale.
    pub fn new(scale: f32, rng: &'a mut dyn Rng) -> Self {
        Self { scale, rng }
    }

    /// A length between two at scale 1, metres.
    pub fn length(&mut self, low: f32, high: f32) -> f32 {
        self.between(low, high) * self.scale
    }

    /// A thickness, metres: it does not follow the scale (a small cup's wall is no thinner), and physics needs some.
    pub fn thickness(&mut self, low: f32, high: f32) -> f32 {
        self.between(low, high)
    }

    /// A number between two.
    pub fn between(&mut self, low: f32, high: f32) -> f32 {
        self.rng.random_range(low..high)
    }

    /// A length between two at scale 1, each factor as likely as any other, metres.
    pub fn log_length(&mut self, low: f32, high: f32) -> f32 {
        self.between(low.ln(), high.ln()).exp() * self.scale
    }

    /// True with a probability.
    pub fn chance(&mut self, probability: f64) -> bool {
        self.rng.random_bool(probability)
    }

    /// A whole number from `low` to `high`, both possible.
    pub fn whole(&mut self, low: usize, high: usize) -> usize {
        self.rng.random_range(low..=high)
    }

    /// One of several.
    pub fn pick<T: Copy>(&mut self, from: &[T]) -> T {
        from[self.rng.random_range(0..from.len())]
    }
}
