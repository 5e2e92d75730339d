//! AdamW with gradients given as plain vectors, one step of plain arithmetic in parameter order.

use std::collections::BTreeMap;

use candle_core::{Result, Tensor, Var};

/// Gradients by parameter path.
pub type Gradients = BTreeMap<String, Vec<f32>>;

/// First and second moments by parameter path.
pub type Moments = BTreeMap<String, (Vec<f32>, Vec<f32>)>;

/// Decay rates and the rest of the usual constants.
const BETA1: f64 = 0.9;
const BETA2: f64 = 0.99;
const EPSILON: f64 = 1e-8;

/// The optimiser's memory.
#[derive(Debug, Default)]
pub struct AdamW {
    step: i32,
    moments: Moments,
}

impl AdamW {
    /// One step. Parameters without a gradient stay as they are; weight decay leaves vectors (biases, norms) alone.
    ///
    /// # Errors
    /// When a gradient has another length than its parameter.
    pub fn step(&mut self, parameters: &BTreeMap<String, Var>, gradients: &Gradients, learning_rate: f64, weight_decay: f64) -> Result<()> {
        self.step += 1;
        let (correct1, correct2) = (1.0 - BETA1.powi(self.step), 1.0 - BETA2.powi(self.step));
        let rate = (learning_rate * correct2.sqrt() / correct1) as f32;
        let (b1, b2, epsilon) = (BETA1 as f32, BETA2 as f32, (EPSILON * correct2.sqrt()) as f32);
        for (name, gradient) in gradients {
            let Some(var) = parameters.get(name) else { continue };
            let mut values = var.flatten_all()?.to_vec1::<f32>()?;
            if values.len() != gradient.len() {
                candle_core::bail!("gradient of {name}: expected {} numbers, got {}", values.len(), gradient.len());
            }
            let decay = if var.rank() > 1 { (1.0 - learning_rate * weight_decay) as f32 } else { 1.0 };
            let (first, second) = self.moments.entry(name.clone()).or_insert_with(|| (vec![0.0; values.len()], vec![0.0; values.len()]));
            for (((value, g), m), v) in values.iter_mut().zip(gradient).zip(first).zip(second) {
                *m = b1 * *m + (1.0 - b1) * g;
                *v = b2 * *v + (1.0 - b2) * g * g;
                *value = *value * decay - rate * *m / (v.sqrt() + epsilon);
            }
            var.set(&Tensor::from_vec(values, var.shape(), var.device())?)?;
        }
        Ok(())
    }

    /// What a checkpoint keeps: the step count and the moments.
    pub fn state(&self) -> (i32, &Moments) {
        (self.step, &self.moments)
    }

    /// Takes up a checkpoint's state.
    pub fn restore(step: i32, moments: Moments) -> Self {
        Self { step, moments }
    }
}

/// Scales gradients down to a norm; returns the norm that they had.
pub fn clip(gradients: &mut Gradients, norm: f64) -> f64 {
    let total = gradients.values().flatten().map(|g| f64::from(*g) * f64::from(*g)).sum::<f64>().sqrt();
    if total > norm {
        let factor = (norm / total) as f32;
        gradients.values_mut().flatten().for_each(|g| *g *= factor);
    }
    total
}

#[cfg(test)]
mod tests {
    use candle_core::Device;

    use super::*;

    #[test]
    fn it_finds_the_bottom_of_a_bowl() {
        let var = Var::from_tensor(&Tensor::new(&[3.0f32, -2.0], &Device::Cpu).unwrap()).unwrap();
        let parameters = BTreeMap::from([("x".to_string(), var)]);
        let mut adam = AdamW::default();
        for _ in 0..400 {
            let x = parameters["x"].to_vec1::<f32>().unwrap();
            let gradients = Gradients::from([("x".to_string(), vec![2.0 * (x[0] - 1.0), 2.0 * x[1]])]);
            adam.step(&parameters, &gradients, 0.05, 0.0).unwrap();
        }
        let x = parameters["x"].to_vec1::<f32>().unwrap();
        assert!((x[0] - 1.0).abs() < 1e-2 && x[1].abs() < 1e-2, "{x:?}");
    }

    #[test]
    fn clipping_keeps_the_direction() {
        let mut gradients = Gradients::from([("a".to_string(), vec![3.0, 0.0]), ("b".to_string(), vec![4.0])]);
        assert_eq!(clip(&mut gradients, 1.0), 5.0);
        assert_eq!(gradients["b"], [0.8]);
    }
}
