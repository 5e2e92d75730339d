//! The networks' inputs, built from ordered clouds, in one place for training and serving.
//!
//! An input is points in an order of which every prefix is a good sample, with one grouping per set abstraction: the centroids are the
//! first of the points, their neighbours the first within the radius.

use crate::{
    ball_query::ball_query,
    config::{NetworksConfig, SetAbstractionConfig},
    kernel::Kernel,
    neighbours::Neighbours,
    points::{ObjectCloud, SceneCloud},
};

/// The input of a chain of set abstractions, for one sample or several.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Grouped {
    /// `[points, 3]`, metres.
    pub points: Vec<[f32; 3]>,
    /// `[points]`: 1 for the query's points, 0 for the scene's. Only the discriminator reads it.
    pub is_query: Vec<f32>,
    /// One grouping per set abstraction; the last has one centroid per sample.
    pub levels: Vec<Grouping>,
}

/// What one set abstraction needs.
#[derive(Debug, Clone, PartialEq)]
pub struct Grouping {
    /// `[centroids, 3]`, metres; also the points of the next level.
    pub centroids: Vec<[f32; 3]>,
    /// Indices into the previous level's points.
    pub neighbours: Neighbours,
}

impl Grouped {
    /// Groups one sample's points (at least one) for the given set abstractions.
    pub fn new(kernel: Kernel, points: Vec<[f32; 3]>, is_query: Vec<f32>, levels: &[SetAbstractionConfig]) -> Self {
        let mut groupings: Vec<Grouping> = Vec::with_capacity(levels.len());
        for config in levels {
            let from = groupings.last().map_or(&points, |g| &g.centroids);
            groupings.push(if config.centroids == 0 {
                Grouping { centroids: vec![[0.0; 3]], neighbours: Neighbours::all(from.len()) }
            } else {
                Grouping {
                    centroids: from[..config.centroids.min(from.len())].to_vec(),
                    neighbours: ball_query(kernel, from, config.centroids, config.neighbours, config.radius_m),
                }
            });
        }
        Self { points, is_query, levels: groupings }
    }

    /// Several samples as one, for training: lists are renumbered, nothing is shared.
    pub fn concat<'a>(samples: impl IntoIterator<Item = &'a Self>) -> Self {
        let mut all = Self::default();
        for sample in samples {
            let mut first_point = all.points.len();
            all.points.extend_from_slice(&sample.points);
            all.is_query.extend_from_slice(&sample.is_query);
            all.levels.resize_with(sample.levels.len(), || Grouping { centroids: Vec::new(), neighbours: Neighbours::new() });
            for (into, from) in all.levels.iter_mut().zip(&sample.levels) {
                into.neighbours.append(&from.neighbours, first_point);
                first_point = into.centroids.len();
                into.centroids.extend_from_slice(&from.centroids);
            }
        }
        all
    }
}

/// The object encoder's input: an object's points about its own centroid.
pub fn object_input(kernel: Kernel, config: &NetworksConfig, object: &ObjectCloud) -> Grouped {
    let is_query = vec![0.0; object.points.len()];
    Grouped::new(kernel, object.points.clone(), is_query, &config.object_levels)
}

/// The scene encoder's input: scene points near `anchor_in_viewer`, about it. A scene with nothing there is one point at the anchor.
pub fn scene_input(kernel: Kernel, config: &NetworksConfig, scene: &SceneCloud, anchor_in_viewer: [f32; 3]) -> Grouped {
    let mut points = first_within(&scene.points, anchor_in_viewer, config.crop_m, config.scene_encoder_points);
    if points.is_empty() {
        points.push([0.0; 3]);
    }
    let is_query = vec![0.0; points.len()];
    Grouped::new(kernel, points, is_query, &config.scene_levels)
}

fn first_within(points: &[[f32; 3]], center: [f32; 3], radius_m: f32, most: usize) -> Vec<[f32; 3]> {
    points.iter().map(|p| relative(p, center)).filter(|p| norm_squared(p) <= radius_m * radius_m).take(most).collect()
}

/// The discriminator's input: the query's points (already turned) with its centroid at `position_in_viewer`, the scene without the query
/// near them, and the rest of the scene within the crop, all about that position.
///
/// The three streams are merged in proportion, so that any prefix (the centroids) holds a fair share of each.
pub fn discriminator_input(
    kernel: Kernel,
    config: &NetworksConfig,
    scene_without_query: &SceneCloud,
    query: &ObjectCloud,
    position_in_viewer: [f32; 3],
) -> Grouped {
    let (points, is_query) = discriminator_points(config, scene_without_query, query, position_in_viewer);
    Grouped::new(kernel, points, is_query, &config.discriminator_levels)
}

/// The points of [`discriminator_input`] and their labels, in order.
pub fn discriminator_points(
    config: &NetworksConfig,
    scene_without_query: &SceneCloud,
    query: &ObjectCloud,
    position_in_viewer: [f32; 3],
) -> (Vec<[f32; 3]>, Vec<f32>) {
    let shares = &config.discriminator_points;
    let [low, high] = query.bounds();
    let box_distance_squared = |p: &[f32; 3]| (0..3).map(|k| (low[k] - p[k]).max(p[k] - high[k]).max(0.0).powi(2)).sum::<f32>();
    let query = &query.points[..query.points.len().min(shares.query)];
    let room = shares.total - query.len();
    let mut near = Vec::with_capacity(shares.near);
    let mut around = Vec::with_capacity(room);
    for p in &scene_without_query.points {
        let p = relative(p, position_in_viewer);
        if norm_squared(&p) <= config.crop_m * config.crop_m {
            if near.len() < shares.near && box_distance_squared(&p) <= shares.near_m * shares.near_m {
                near.push(p);
            } else if around.len() < room {
                around.push(p);
            }
            if near.len() == shares.near && near.len() + around.len() >= room {
                break;
            }
        }
    }
    around.truncate(room - near.len());
    merged([(query, 1.0), (&near, 0.0), (&around, 0.0)])
}

/// Streams merged so that each prefix holds them in proportion to their lengths; ties go to the earlier stream.
fn merged(streams: [(&[[f32; 3]], f32); 3]) -> (Vec<[f32; 3]>, Vec<f32>) {
    let total: usize = streams.iter().map(|(s, _)| s.len()).sum();
    let mut taken = [0usize; 3];
    let mut points = Vec::with_capacity(total);
    let mut labels = Vec::with_capacity(total);
    for _ in 0..total {
        // The stream that is furthest behind: lowest (taken + 1) / length, compared without dividing.
        let mut next = None;
        for (s, (stream, _)) in streams.iter().enumerate().filter(|(s, (stream, _))| taken[*s] < stream.len()) {
            let behind = |n: usize| (taken[s] + 1) * streams[n].0.len() < (taken[n] + 1) * stream.len();
            if next.is_none_or(behind) {
                next = Some(s);
            }
        }
        if let Some(s) = next {
            points.push(streams[s].0[taken[s]]);
            labels.push(streams[s].1);
            taken[s] += 1;
        }
    }
    (points, labels)
}

fn relative(p: &[f32; 3], center: [f32; 3]) -> [f32; 3] {
    std::array::from_fn(|k| p[k] - center[k])
}

fn norm_squared(p: &[f32; 3]) -> f32 {
    p[0] * p[0] + p[1] * p[1] + p[2] * p[2]
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;

    fn plane(spacing_m: f32) -> SceneCloud {
        let side = (1.4 / spacing_m) as i32;
        let points =
            (0..side * side).map(|i| [(i % side) as f32 * spacing_m - 0.7, (i / side) as f32 * spacing_m - 0.7, 0.0]).collect::<Vec<_>>();
        SceneCloud { labels: vec![0; points.len()], points }
    }

    fn cube() -> ObjectCloud {
        let points: Vec<_> = (0..1000).map(|i| Point3::new((i % 10) as f32, (i / 10 % 10) as f32, (i / 100) as f32) * 0.006).collect();
        ObjectCloud::new(&points, &crate::points::tests::observer(), &crate::points::CloudConfig::default()).unwrap()
    }

    #[test]
    fn the_discriminator_gets_its_shares_and_every_prefix_is_mixed() {
        let config = NetworksConfig::default();
        let (points, labels) = discriminator_points(&config, &plane(0.005), &cube(), [0.0, 0.0, 0.04]);
        assert_eq!(points.len(), 2048);
        assert_eq!(labels.iter().sum::<f32>(), 512.0);
        assert_eq!(labels[..512].iter().sum::<f32>(), 128.0);
        assert!(points.iter().all(|p| norm_squared(p) <= 0.25 + 1e-6));
    }

    #[test]
    fn samples_side_by_side_keep_their_own_neighbours() {
        let config = NetworksConfig::default();
        let one = object_input(Kernel::detect(), &config, &cube());
        let two = Grouped::concat([&one, &one]);
        let n = one.points.len() as u32;
        let m = one.levels[0].centroids.len();
        let raised: Vec<u32> = one.levels[0].neighbours.of(3).iter().map(|i| i + n).collect();
        assert_eq!(two.levels[0].neighbours.of(m + 3), &raised[..]);
        assert_eq!(two.levels[2].neighbours.centroids(), 2);
        assert_eq!(two.levels[2].neighbours.of(1)[0] as usize, one.levels[1].centroids.len());
    }
}
