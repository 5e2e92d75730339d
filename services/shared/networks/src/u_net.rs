//! The body of the networks that read pictures: a U-net with added skips.
//!
//! Each resolution has a convolution to its channels and one that is added to its input; the coarsest has one more of these, after a layer on the picture's
//! mean. From there each coarser picture is narrowed, doubled and added to the finer one, followed by ReLU and a convolution that is added.

use crate::feature_map::FeatureMap;
use crate::kernel::{Kernel, PackedLinear};
use crate::layer_file::LayerFile;
use crate::weights::WeightsError;

/// The layers; those of each resolution, finest first.
#[derive(Debug, Clone)]
pub(crate) struct UNet {
    kernel: Kernel,
    stem: PackedLinear,
    same: Vec<PackedLinear>,
    down: Vec<PackedLinear>,
    whole: PackedLinear,
    same_again: PackedLinear,
    /// From the next coarser picture's channels to those of each but the coarsest.
    narrow: Vec<PackedLinear>,
    join: Vec<PackedLinear>,
}

impl UNet {
    /// The layers of a network of that name in a file, for so many inputs and channels at each resolution.
    ///
    /// # Errors
    /// As [`LayerFile::layer`].
    pub fn load<const N: usize>(
        file: &LayerFile,
        network: &str,
        inputs: usize,
        widths: [usize; N],
        kernel: Kernel,
    ) -> Result<Self, WeightsError> {
        let layer = |name: &str, shape: &[usize]| file.layer(&format!("{network}/{name}"), shape);
        let square = |name: &str, inputs: usize, outputs: usize| layer(name, &[outputs, 3, 3, inputs]);
        let finer = || widths.windows(2).enumerate();
        let coarsest = widths[N - 1];
        Ok(Self {
            kernel,
            stem: square("stem", inputs, widths[0])?,
            same: widths.iter().enumerate().map(|(k, w)| square(&format!("same{k}"), *w, *w)).collect::<Result<_, _>>()?,
            down: finer().map(|(k, w)| square(&format!("down{}", k + 1), w[0], w[1])).collect::<Result<_, _>>()?,
            whole: layer("whole", &[coarsest, coarsest])?,
            same_again: square(&format!("same{}b", N - 1), coarsest, coarsest)?,
            narrow: finer().map(|(k, w)| layer(&format!("narrow{k}"), &[w[0], 1, 1, w[1]])).collect::<Result<_, _>>()?,
            join: finer().map(|(k, w)| square(&format!("join{k}"), w[0], w[0])).collect::<Result<_, _>>()?,
        })
    }

    /// The finest resolution's features. The same inputs give the same bits on any number of threads.
    pub fn features(&self, inputs: &FeatureMap) -> FeatureMap {
        let kernel = self.kernel;
        let plus_own = |x: FeatureMap, layer: &PackedLinear| {
            let more = x.convolved(kernel, layer, 1);
            x.plus(&more)
        };
        let mut x = plus_own(inputs.convolved(kernel, &self.stem, 1), &self.same[0]);
        let mut finer = Vec::with_capacity(self.down.len());
        for (down, same) in self.down.iter().zip(&self.same[1..]) {
            let half = plus_own(x.convolved(kernel, down, 2), same);
            finer.push(std::mem::replace(&mut x, half));
        }
        let mut whole = vec![0.0; self.whole.padded()];
        kernel.linear(&self.whole, &x.mean(), 1, true, &mut whole);
        x = plus_own(x.plus_everywhere(&whole), &self.same_again);
        for ((finer, narrow), join) in finer.into_iter().zip(&self.narrow).zip(&self.join).rev() {
            x = plus_own(finer.plus_twice_as_large(&x.projected(kernel, narrow)), join);
        }
        x
    }
}
