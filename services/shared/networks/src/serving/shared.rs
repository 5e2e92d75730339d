//! The outcome network on a scene whose features are computed once ([`crate::shared_scene`]).

use crate::{
    config::NetworksConfig,
    kernel::Kernel,
    neighbours::Neighbours,
    points::{ObjectCloud, SceneCloud},
    shared_scene::{PlacedQuery, SharedScene},
};

use super::point_net::{PackedPointNet, Scratch};

/// A scene without one query, and the features of its centroids.
#[derive(Debug, Clone)]
pub struct SceneFeatures {
    scene: SharedScene,
    /// Of the centroids of the first and the second level, `[centroids, outputs]`.
    features: [Vec<f32>; 2],
}

impl SceneFeatures {
    /// Computes the scene's own levels; takes a few milliseconds.
    pub(super) fn new(kernel: Kernel, config: &NetworksConfig, points: &PackedPointNet, scene_without_query: &SceneCloud) -> Self {
        let scene = SharedScene::new(kernel, config, scene_without_query);
        let scratch = &mut Scratch::default();
        let [_, n1, n2] = scene.counts;
        let labels = vec![0.0; scene.points.len()];
        let first = points.level(kernel, 0, &scene.points, &labels, &scene.points[..n1], &scene.first, scratch);
        let second = points.level(kernel, 1, &scene.points[..n1], &first, &scene.points[..n2], &scene.second, scratch);
        Self { scene, features: [first, second] }
    }

    /// The last level's features of the query (already turned) at a position.
    pub(super) fn of_candidate(
        &self,
        kernel: Kernel,
        config: &NetworksConfig,
        points: &PackedPointNet,
        query: &ObjectCloud,
        position: [f32; 3],
        scratch: &mut Scratch,
    ) -> Vec<f32> {
        let placed = self.scene.placed(kernel, config, query, position);
        let mut own = vec![1.0; placed.points.len()];
        for level in 0..placed.lists.len() {
            own = self.level(kernel, points, &placed, level, &own, scratch);
        }
        let last = placed.lists.len();
        let all = Neighbours::all(placed.lists[last - 1].centroids());
        let centroids = &placed.centroids[..all.of(0).len()];
        points.level(kernel, last, centroids, &own, &[placed.position], &all, scratch)
    }

    /// One level of the query's centroids, from its own features and those of the scene that their lists name.
    fn level(
        &self,
        kernel: Kernel,
        points: &PackedPointNet,
        placed: &PlacedQuery,
        level: usize,
        own: &[f32],
        scratch: &mut Scratch,
    ) -> Vec<f32> {
        let lists = &placed.lists[level];
        let of_query = if level == 0 { &placed.points[..] } else { &placed.centroids[..placed.lists[level - 1].centroids()] };
        let (width, count) = (own.len() / of_query.len(), self.scene.counts[level]);
        // The points that the lists name, numbered anew: the query's own first, then the scene's, in the order of the lists.
        let mut seen = of_query.to_vec();
        let mut features = own.to_vec();
        let mut numbers = vec![u32::MAX; count];
        let mut renumbered = Neighbours::new();
        let mut list = Vec::new();
        for c in 0..lists.centroids() {
            list.clear();
            for i in lists.of(c) {
                let i = *i as usize;
                if let Some(own) = i.checked_sub(count) {
                    list.push(own as u32);
                    continue;
                }
                if numbers[i] == u32::MAX {
                    numbers[i] = seen.len() as u32;
                    seen.push(self.scene.points[i]);
                    match level {
                        0 => features.push(0.0),
                        _ => features.extend_from_slice(&self.features[level - 1][i * width..(i + 1) * width]),
                    }
                }
                list.push(numbers[i]);
            }
            renumbered.push(&list);
        }
        points.level(kernel, level, &seen, &features, &placed.centroids[..lists.centroids()], &renumbered, scratch)
    }
}
